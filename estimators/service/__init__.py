"""The estimator service: versions of models, and what has to hold before one may serve."""
