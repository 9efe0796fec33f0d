"""What every package uses and none owns: checks, files, progress, poses, moved names."""
