"""Estimators of a model's parameters, one file an estimator; they are found by themselves."""
