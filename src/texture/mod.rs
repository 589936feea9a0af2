//! Species to bark and leaf pictures, made by the program. Knows nothing of meshes.
