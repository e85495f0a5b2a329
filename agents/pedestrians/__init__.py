"""The pedestrian policies that crowdbench ships: a file each, or a folder with the file of the same name."""
