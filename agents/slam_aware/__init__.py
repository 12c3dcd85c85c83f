"""Scripted teams whose decisions depend on the state of SLAM: who shares a map, who hears whom, how far poses drift."""
