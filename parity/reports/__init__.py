"""What a comparison found: tables, charts, films, one page."""
