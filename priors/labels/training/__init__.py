"""The training of labels on clouds whose points know where on a body they lie."""
