"""Where each process of a cell is put together, and the run that starts them all."""
