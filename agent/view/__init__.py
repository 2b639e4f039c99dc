"""A run in three dimensions: what stands where at each instant, drawn as a still, a film or a page in the browser."""
