"""Small tools that know nothing of crowds: files, errors, interrupts, tables, compiled code."""
