"""The report: every picture once, one maker of pages, and the files of each command."""
