"""The cell file and the arm files: read once, validated, frozen.  The only place that reads TOML."""
