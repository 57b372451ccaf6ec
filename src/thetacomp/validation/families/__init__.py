"""Families of models beside the stored one, for comparison only: same folds, same search budget, never exported."""
