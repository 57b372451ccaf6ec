"""Validation on held-out data: folds, residuals, column deviation, permutation, acceptance."""
