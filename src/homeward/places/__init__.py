"""Places, kept between drives: maps with homes, routes and the persistence of landmarks."""
