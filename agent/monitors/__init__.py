"""What one arm watches of itself in every mode that commands, beside the flags of its law."""
