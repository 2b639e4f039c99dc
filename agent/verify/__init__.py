"""What must hold before a start: the check, its margins, and the gains that meet them."""
