"""Training: the parts that the trainings of all priors share."""
