"""One file a control: what it can do, its sign, its units, its files."""
