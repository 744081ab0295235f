"""`bms-ukf monitor`: what is on the bus, for a person."""
