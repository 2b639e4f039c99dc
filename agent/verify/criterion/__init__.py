"""Whether a cell stays stable in what reality may make of it: its sampled loop in many cases, and the worst by name.

Nothing here reads a file or knows a cell; `agent.verify.robustness` brings both together.
"""
