"""Tables about maps that last: sessions after one another in one building, and localisation in a finished map."""
