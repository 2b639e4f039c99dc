"""What may stand in a cell file and in an arm file, key by key."""
