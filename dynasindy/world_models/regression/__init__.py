"""Linear regression on candidate functions: rows out of data, the functions that matter, what the data can tell."""
