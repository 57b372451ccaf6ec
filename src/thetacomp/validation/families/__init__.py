"""Other families of models, for comparison only: same folds, same search budget, never exported."""
