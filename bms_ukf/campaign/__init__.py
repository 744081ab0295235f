"""The honesty campaign: seeded random situations, cut from traces of plants, run through the daemon's own core."""
