"""The paper's three filters and their peers."""
