"""General tools, independent of crowds: files, errors, interrupts, tables, compiled code."""
