"""The paper's tables and figures, redrawn: its cases as printed, and over many layouts."""
