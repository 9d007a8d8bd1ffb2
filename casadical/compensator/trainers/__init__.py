"""The ways to train a network, one small file each."""
