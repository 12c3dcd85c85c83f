"""How robots move and are moved: start poses, dynamics with collisions, kidnapping, bumps and slips."""
