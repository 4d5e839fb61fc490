"""The paper's four simulated cases, with what it leaves open as options."""
