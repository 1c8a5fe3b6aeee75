"""The report: the paper's figures and tables beside ours, from saved results."""
