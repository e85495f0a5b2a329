"""The planners, the pedestrian policies and the weights that crowdbench ships."""
