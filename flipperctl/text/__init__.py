"""Texts of errors, tables, and files that are read and written."""
