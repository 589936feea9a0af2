//! The curve of sRGB, IEC 61966-2-1.

use std::sync::LazyLock;

/// [`linear_from_srgb`] as a table.
pub static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let c = i as f32 / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    })
});

/// Linear light of 8-bit sRGB.
pub fn linear_from_srgb(c: u8) -> f32 {
    LINEAR_FROM_SRGB[usize::from(c)]
}

/// 8-bit sRGB of linear light 0…1, not rounded.
pub fn srgb_from_linear(c: f32) -> f32 {
    let c = c.clamp(0.0, 1.0);
    255.0 * if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}
