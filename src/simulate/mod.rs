//! A stand with known truth, and the scan and photo that a survey of it would give. Knows nothing
//! of reconstruction.
