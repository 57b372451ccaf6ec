"""The ruler of carrying over: many machines, every model and baseline, one table."""
