"""The store: versions of models, which one serves, and whether it is fit to."""
