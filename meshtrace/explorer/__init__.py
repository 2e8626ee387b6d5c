"""Explorer of a link in the browser: state, work in stages, scene and page."""
