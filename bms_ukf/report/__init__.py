"""The report of one run: plots as PNG files and one self-contained HTML page."""
