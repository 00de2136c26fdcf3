"""The report of a comparison: tables, charts, films, one page."""
