//! A validated scene to a picture: our own software rasteriser. Knows nothing of files.
