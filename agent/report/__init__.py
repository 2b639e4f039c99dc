"""A run in figures, tables and one page, from its log alone."""
