"""Multi-view stereo."""
