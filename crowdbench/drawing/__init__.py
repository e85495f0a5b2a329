"""An episode as shapes in metres, and their colours: for figures, films, environments, recordings and pages."""
