"""A sparse model in other words: torch code, machine code, formulas, tables of text, and files."""
