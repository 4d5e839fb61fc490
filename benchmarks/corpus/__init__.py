"""The inputs of the readers and of the import, frozen as digests."""
