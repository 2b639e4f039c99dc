"""The control laws: pure functions of (q, dq, t, offline data, memory); no clock, bus, file or log."""
