"""What does each number in the localiser do? See `python -m` of this package."""
