"""A full survey makes a reflector-navigation system: how accurate, beside what peers do."""
