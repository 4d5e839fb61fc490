"""Many runs at once: the same program in every lane and thread."""
