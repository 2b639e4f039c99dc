"""The command `coop`: parse, dispatch, print."""
