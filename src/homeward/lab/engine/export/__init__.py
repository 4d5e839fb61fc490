"""C for microcontrollers, from the symbolic source: a library folder that needs no homeward."""
