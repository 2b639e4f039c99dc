"""The schema of cell files and arm files."""
