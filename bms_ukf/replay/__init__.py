"""Recordings re-run through an estimator."""
