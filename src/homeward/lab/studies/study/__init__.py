"""Monte Carlo studies: estimators x scenarios x runs."""
