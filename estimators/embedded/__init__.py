"""An estimator as C code: everything that a stream of estimates needs, in one pair of files."""
