"""`bms-ukf replay`: recordings re-run through an estimator."""
