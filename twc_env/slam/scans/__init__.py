"""What a laser scan shows: beams to leave out, walls and free floor drawn into grids."""
