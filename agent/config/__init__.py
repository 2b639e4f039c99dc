"""Cell and arm files: read once, validated, frozen."""
