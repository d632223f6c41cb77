"""Clouds whose points know where on a body they lie: what a network learns labels from."""
