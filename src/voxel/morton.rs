//! Morton codes (Morton 1966): the bits of three indices interleaved, so that the voxels of every
//! octree node are a run of codes. From the highest bit: l, c, r, l, c, r, …

use super::VoxelIndex;

pub(super) const AXIS_BITS: u32 = 21;

/// Spreads the low 21 bits to every third place.
fn spread(v: u32) -> u64 {
    let mut v = u64::from(v) & 0x1f_ffff;
    v = (v | (v << 32)) & 0x001f_0000_0000_ffff;
    v = (v | (v << 16)) & 0x001f_0000_ff00_00ff;
    v = (v | (v << 8)) & 0x100f_00f0_0f00_f00f;
    v = (v | (v << 4)) & 0x10c3_0c30_c30c_30c3;
    (v | (v << 2)) & 0x1249_2492_4924_9249
}

pub(super) fn encode(index: VoxelIndex) -> u64 {
    spread(index.r) | (spread(index.c) << 1) | (spread(index.l) << 2)
}

/// The octant (0–7) of `index` in the node whose children have an edge of 2^`shift` voxels.
pub(super) fn octant(index: VoxelIndex, shift: u32) -> u32 {
    let bit = |v: u32| (v >> shift) & 1;
    bit(index.r) | (bit(index.c) << 1) | (bit(index.l) << 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn octants_are_the_digits_of_the_code(
            r in 0u32..1 << 21, c in 0u32..1 << 21, l in 0u32..1 << 21,
        ) {
            let index = VoxelIndex { r, c, l };
            let digits = (0..21).map(|s| u64::from(octant(index, s)) << (3 * s)).sum::<u64>();
            prop_assert_eq!(encode(index), digits);
        }
    }

    #[test]
    fn the_last_voxel_has_all_bits() {
        let last = (1 << 21) - 1;
        assert_eq!(encode(VoxelIndex { r: last, c: last, l: last }), (1 << 63) - 1);
    }
}
