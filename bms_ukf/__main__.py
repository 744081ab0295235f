"""`python -m bms_ukf` is the `bms-ukf` command."""

from bms_ukf.cli import main

main()
