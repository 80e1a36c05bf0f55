"""Runs side by side: tables, curves of error against run time, pictures, a page. Needs no torch."""
