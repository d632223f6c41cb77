"""Energies of single steps between given frames: the networks on all of them at once."""
