"""An effect and an estimator that limo lacks, as another distribution adds them."""
