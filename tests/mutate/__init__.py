"""One-line changes to the code that moves arms; each must fail a named test (`make mutate`)."""
