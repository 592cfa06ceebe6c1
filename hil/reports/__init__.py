"""What the pages of commands show: their answers as contents of `hil.pages`. Nothing is computed here that an answer does not have."""
