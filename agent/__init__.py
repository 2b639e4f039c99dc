"""One arm's process and the tools around its log."""
