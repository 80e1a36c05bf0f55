"""What run folders say, side by side: tables, curves of error against run time, pictures, one page. Needs no torch."""
