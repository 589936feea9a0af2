//! Points to a sparse voxel octree with one centre of mass a voxel ([TD17], method "Voxels").
//! Knows nothing of trees.
