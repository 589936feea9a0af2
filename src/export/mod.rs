//! A validated scene to files. Decides nothing; knows nothing but [`crate::scene`].
