//! LAS, LAZ and XYZ files to one [`PointCloud`] in local metres, with noise removed.
//! Knows nothing of what points mean.

use glam::Vec3;

use crate::frame::Frame;

/// Points as columns of equal length, in local metres, Z up.
#[derive(Debug, Clone)]
pub struct PointCloud {
    pub frame: Frame,
    pub position: Vec<Vec3>,
    pub intensity: Vec<u16>,
    /// 1-based; 1 where the file says nothing sound.
    pub return_number: Vec<u8>,
    /// Returns of the pulse, >= `return_number`.
    pub return_count: Vec<u8>,
    /// ASPRS class code, as in the file.
    pub class: Vec<u8>,
    /// 16-bit colour where the file carries it.
    pub rgb: Option<Vec<[u16; 3]>>,
}

impl PointCloud {
    pub fn len(&self) -> usize {
        self.position.len()
    }

    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }
}
