"""Reports: words, tables and figures as data, and renderers for terminal, HTML, PDF and JSON."""
