"""MCAP logs: written chunk by chunk, read whole or by column, scanned however they end, mended."""
