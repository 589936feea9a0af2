//! Every point format, packed and plain, sound and damaged.

use std::io::Cursor;

use laz::{LasZipCompressor, LazVlrBuilder};

use super::*;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Packing {
    Plain,
    Fixed(u32),
    /// Chunks of 700 and 300 points in turn.
    Varying,
}

const COUNT: usize = 3_000;
const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

fn rgb_at(format: usize) -> Option<usize> {
    [None, None, Some(20), Some(28), None, Some(28), None, Some(30), Some(30), None, Some(30)]
        [format]
}

/// A file of `COUNT` points with bytes of our own in every field, `extra` bytes behind each.
fn file(format: usize, extra: usize, packing: Packing) -> Vec<u8> {
    let mut draws = Seed::new(3).derive("file", format as u64).draws();
    let size = RECORD_BYTES[format] + extra;
    let mut records: Vec<u8> = Vec::new();
    let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
    for i in 0..COUNT as i32 {
        let steps = [i % 60 * 500, i / 60 * 500, draws.index(20_000) as i32];
        for axis in 0..3 {
            low[axis] = low[axis].min(steps[axis]);
            high[axis] = high[axis].max(steps[axis]);
        }
        let start = records.len();
        records.extend(steps.iter().flat_map(|s| s.to_le_bytes()));
        records.extend((draws.index(4000) as u16).to_le_bytes());
        let count = 1 + draws.index(3) as u8;
        let number = 1 + draws.index(usize::from(count)) as u8;
        let class = [1, 2, 5][draws.index(3)];
        if format >= 6 {
            records.extend([number | (count << 4), 0, class, 9, 1, 0, 7, 0]);
            records.extend((1000.0 + f64::from(i) * 1e-4).to_le_bytes());
        } else {
            records.extend([number | (count << 3), class, 5, 9, 7, 0]);
        }
        while records.len() - start < size {
            records.push(if (i as usize + records.len()).is_multiple_of(5) { 1 } else { 0 });
        }
        if let Some(at) = rgb_at(format) {
            for (k, v) in [i * 20, 3000, i * 7].into_iter().enumerate() {
                let at = start + at + 2 * k;
                records[at..at + 2].copy_from_slice(&(v as u16).to_le_bytes());
            }
        }
    }
    let vlr = match packing {
        Packing::Plain => None,
        _ => {
            let builder =
                LazVlrBuilder::default().with_point_format(format as u8, extra as u16).unwrap();
            Some(match packing {
                Packing::Fixed(n) => builder.with_fixed_chunk_size(n).build(),
                _ => builder.with_variable_chunk_size().build(),
            })
        }
    };
    let mut vlr_bytes = Vec::new();
    if let Some(vlr) = &vlr {
        let mut body = Vec::new();
        vlr.write_to(&mut body).unwrap();
        vlr_bytes.extend([0, 0]);
        vlr_bytes.extend(b"laszip encoded\0\0");
        vlr_bytes.extend(22204u16.to_le_bytes());
        vlr_bytes.extend((body.len() as u16).to_le_bytes());
        vlr_bytes.extend([0; 32]);
        vlr_bytes.extend(body);
    }
    // The oldest version that has the format.
    let minor = [0, 0, 2, 2, 3, 3, 4, 4, 4, 4, 4][format];
    let header_bytes: u16 = [227, 227, 227, 235, 375][minor];
    let world = |steps: [i32; 3]| steps.map(|s| f64::from(s) * 0.001);
    let (low, high) = (world(low), world(high));
    let header = las::raw::Header {
        version: las::Version::new(1, minor as u8),
        header_size: header_bytes,
        offset_to_point_data: u32::from(header_bytes) + vlr_bytes.len() as u32,
        number_of_variable_length_records: u32::from(vlr.is_some()),
        point_data_record_format: format as u8 | if vlr.is_some() { 0x80 } else { 0 },
        point_data_record_length: size as u16,
        number_of_point_records: if minor < 4 { COUNT as u32 } else { 0 },
        large_file: (minor == 4).then_some(las::raw::header::LargeFile {
            number_of_point_records: COUNT as u64,
            number_of_points_by_return: [0; 15],
        }),
        x_scale_factor: 0.001,
        y_scale_factor: 0.001,
        z_scale_factor: 0.001,
        min_x: low[0],
        min_y: low[1],
        min_z: low[2],
        max_x: high[0],
        max_y: high[1],
        max_z: high[2],
        ..las::raw::Header::default()
    };
    let mut out = Cursor::new(Vec::new());
    header.write_to(&mut out).unwrap();
    let mut bytes = out.into_inner();
    bytes.extend(vlr_bytes);
    assert_eq!(bytes.len(), header.offset_to_point_data as usize);
    let Some(vlr) = vlr else {
        bytes.extend(records);
        return bytes;
    };
    let mut out = Cursor::new(bytes);
    out.set_position(u64::from(header.offset_to_point_data));
    let mut packer = LasZipCompressor::new(out, vlr).unwrap();
    if packing == Packing::Varying {
        let mut rest = records.as_slice();
        for n in [700, 300].into_iter().cycle() {
            let (chunk, others) = rest.split_at((n * size).min(rest.len()));
            packer.compress_many(chunk).unwrap();
            rest = others;
            if rest.is_empty() {
                break;
            }
            packer.finish_current_chunk().unwrap();
        }
    } else {
        packer.compress_many(&records).unwrap();
    }
    packer.done().unwrap();
    packer.into_inner().into_inner()
}

fn read_bytes(bytes: &[u8]) -> Result<Warned<Scan>> {
    let folder = tempfile::tempdir().unwrap();
    let path = write_file(&folder, "scan.laz", bytes);
    let options = ReadOptions { drop_isolated: false, ..ReadOptions::default() };
    read(&[path], &options)
}

/// Warnings but for the missing system and without the name of the file.
fn warnings(read: &Warned<Scan>) -> Vec<&str> {
    let texts = read.warnings.iter().filter(|w| !w.starts_with("no coordinate system"));
    texts.map(|w| w.split("scan.laz: ").last().unwrap()).collect()
}

/// The points of `got` are those of `whole` at `kept`, in order.
fn assert_points(got: &Scan, whole: &Scan, kept: impl Iterator<Item = usize>, what: &str) {
    let kept: Vec<usize> = kept.collect();
    sound_enough(got);
    assert_eq!(got.cloud.len(), kept.len(), "{what}");
    let shift = (got.cloud.frame.origin - whole.cloud.frame.origin).as_vec3();
    for (k, &i) in kept.iter().enumerate() {
        let (a, b) = (&got.cloud, &whole.cloud);
        assert!(a.position[k].distance(b.position[i] - shift) < 1e-4, "{what}: point {i}");
        assert_eq!(a.intensity[k], b.intensity[i], "{what}: point {i}");
        assert_eq!(a.class[k], b.class[i], "{what}: point {i}");
        assert_eq!(a.return_count[k], b.return_count[i], "{what}: point {i}");
        if let (Some(a), Some(b)) = (&a.rgb, &b.rgb) {
            assert_eq!(a[k], b[i], "{what}: point {i}");
        }
    }
}

fn data_offset(bytes: &[u8]) -> usize {
    u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize
}

fn table_at(bytes: &[u8]) -> usize {
    let at = data_offset(bytes);
    i64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize
}

fn set_count(bytes: &mut [u8], format: usize, count: u64) {
    if format >= 6 {
        bytes[247..255].copy_from_slice(&count.to_le_bytes());
    } else {
        bytes[107..111].copy_from_slice(&(count as u32).to_le_bytes());
    }
}

/// Formats that the `laz` crate packs.
const PACKED: [usize; 11] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10];

#[test]
fn every_point_format_is_read_plain_and_packed() {
    for format in 0..=10 {
        for extra in [0, 3] {
            let plain = read_bytes(&file(format, extra, Packing::Plain)).unwrap();
            assert_eq!(warnings(&plain), [""; 0], "format {format}");
            let plain = plain.value;
            sound(&plain);
            assert_eq!(plain.cloud.len(), COUNT);
            assert_eq!(plain.cloud.rgb.is_some(), rgb_at(format).is_some(), "format {format}");
            for packing in [Packing::Fixed(50_000), Packing::Fixed(1_000), Packing::Varying] {
                let what = format!("format {format} with {extra} extra bytes, {packing:?}");
                let read = read_bytes(&file(format, extra, packing)).unwrap();
                assert_eq!(warnings(&read), [""; 0], "{what}");
                assert_points(&read.value, &plain, 0..COUNT, &what);
            }
        }
    }
}

#[test]
fn a_chunk_table_that_is_absent_or_wrong_costs_no_point() {
    for format in PACKED {
        let whole = read_bytes(&file(format, 2, Packing::Plain)).unwrap().value;
        for packing in [Packing::Fixed(700), Packing::Varying] {
            let sound = file(format, 2, packing);
            let (data, table) = (data_offset(&sound), table_at(&sound));
            let place = |at: i64| {
                let mut bytes = sound.clone();
                bytes[data..data + 8].copy_from_slice(&at.to_le_bytes());
                bytes
            };
            let mut noise = sound.clone();
            noise[table + 8..].fill(0x5a);
            let mut many = sound.clone();
            many[table + 4..table + 8].fill(0xff);
            let mut few = sound.clone();
            few[table + 4..table + 8].copy_from_slice(&2u32.to_le_bytes());
            let cut = sound[..table].to_vec();
            let mut interrupted = place(-1);
            interrupted.truncate(table);
            set_count(&mut interrupted, format, 0);
            for (name, bytes) in [
                ("no place", place(-1)),
                ("a place before the data", place(3)),
                ("a place past the end", place(1 << 40)),
                ("a place amid the data", place(table as i64 - 40)),
                ("noise", noise),
                ("too many chunks", many),
                ("too few chunks", few),
                ("cut off", cut),
                ("its writing was interrupted", interrupted),
            ] {
                let what = format!("format {format}, {packing:?}, {name}");
                let read = match read_bytes(&bytes) {
                    Ok(read) => read,
                    // Chunks of varying size follow each other only where they tell their size.
                    Err(error) if format < 6 && packing == Packing::Varying => {
                        assert!(error.message().contains("varying size"), "{what}: {error}");
                        continue;
                    }
                    Err(error) => panic!("{what}: {error:?}"),
                };
                if name == "too few chunks" && format < 6 && packing == Packing::Varying {
                    continue;
                }
                assert!(!warnings(&read).is_empty(), "{what}");
                assert_points(&read.value, &whole, 0..COUNT, &what);
            }
        }
    }
}

#[test]
fn a_wrong_chunk_size_costs_no_point() {
    for format in PACKED {
        let whole = read_bytes(&file(format, 2, Packing::Plain)).unwrap().value;
        for (packing, is) in [
            (Packing::Fixed(700), "of 700 points"),
            (Packing::Fixed(1_000), "of 1000 points"),
            (Packing::Fixed(50_000), "of 3000 points"),
            (Packing::Varying, "of varying size"),
        ] {
            let sound = file(format, 2, packing);
            // Behind the head of the record: compressor, coder, version and options.
            let name = sound.windows(14).position(|bytes| bytes == b"laszip encoded").unwrap();
            let at = name + 52 + 12;
            for stated in [1u32, 100, 690, 701, 900, 2_000, 49_999, 50_000, 4_000_000_000, u32::MAX]
            {
                let mut bytes = sound.clone();
                bytes[at..at + 4].copy_from_slice(&stated.to_le_bytes());
                let what = format!("format {format}, {packing:?}, stated {stated}");
                let read = read_bytes(&bytes).unwrap();
                assert_points(&read.value, &whole, 0..COUNT, &what);
                let told = warnings(&read);
                let is_told = told.len() == 1 && told[0].contains(is);
                // One chunk is as right with any greater size.
                let is_alike = packing == Packing::Fixed(50_000) && stated >= 3_000;
                let is_right = packing == Packing::Varying && stated == u32::MAX;
                assert_eq!(is_told, !is_alike && !is_right, "{what}: {told:?}");
            }
        }
    }
}

#[test]
fn damaged_chunks_are_left_out_and_told() {
    for format in PACKED {
        let whole = read_bytes(&file(format, 0, Packing::Plain)).unwrap().value;
        let mut bytes = file(format, 0, Packing::Fixed(500));
        let (data, table) = (data_offset(&bytes), table_at(&bytes));
        // In the third of six chunks.
        let at = data + 8 + (table - data - 8) * 5 / 12;
        bytes[at..at + 60].iter_mut().for_each(|b| *b ^= 0x5a);
        let read = read_bytes(&bytes).unwrap();
        let what = format!("format {format}: {:?}", warnings(&read));
        // A byte of a field that is not read may be damaged without loss.
        if format < 6 || !warnings(&read).is_empty() {
            let kept = (0..COUNT).filter(|i| !(1000..1500).contains(i));
            assert_points(&read.value, &whole, kept, &what);
            assert_eq!(
                warnings(&read),
                [
                    "1 of its LAZ chunks are damaged and were left out",
                    "the header promises 3000 points; 500 of them are lost, 2500 were read"
                ]
            );
        }
    }
}

#[test]
fn a_file_cut_short_gives_what_lies_before_the_cut() {
    for format in PACKED {
        let whole = read_bytes(&file(format, 0, Packing::Plain)).unwrap().value;
        for packing in [Packing::Plain, Packing::Fixed(500), Packing::Fixed(50_000)] {
            let sound = file(format, 0, packing);
            let data = data_offset(&sound);
            let mut least = 0;
            for tenth in 1..10 {
                let end = data + 8 + (sound.len() - data - 8) * tenth / 10;
                let what = format!("format {format}, {packing:?}, {tenth} tenths");
                match read_bytes(&sound[..end]) {
                    Ok(read) => {
                        let n = read.value.cloud.len();
                        assert!(n >= least && n < COUNT, "{what}: {n}");
                        least = n;
                        assert_points(&read.value, &whole, 0..n, &what);
                        let told = format!("{} of them are lost, {n} were read", COUNT - n);
                        assert!(warnings(&read).last().unwrap().ends_with(&told), "{what}");
                        assert!(n % 500 == 0 || format < 6 || packing == Packing::Plain, "{what}");
                    }
                    Err(error) => {
                        let text = error.message();
                        assert!(text.starts_with("none of its 3000 points"), "{what}: {text}");
                        // Only where no chunk is whole and none tells points before its end.
                        assert!(format >= 6 && least == 0, "{what}");
                    }
                }
            }
            let is_one_layered_chunk = format >= 6 && packing == Packing::Fixed(50_000);
            assert!(is_one_layered_chunk || least > COUNT * 3 / 4, "format {format}, {packing:?}");
        }
    }
}

#[test]
fn counts_and_bounds_in_the_header_may_be_wrong() {
    for format in PACKED {
        for packing in [Packing::Plain, Packing::Fixed(700), Packing::Varying] {
            let sound = file(format, 0, packing);
            let whole = read_bytes(&sound).unwrap().value;
            for count in [0, 1, 800, 2_999, 3_001, 10_000, 4_000_000_000] {
                let mut bytes = sound.clone();
                set_count(&mut bytes, format, count);
                let read = read_bytes(&bytes).unwrap();
                let what = format!("format {format}, {packing:?}, {count}: {:?}", warnings(&read));
                assert!(!warnings(&read).is_empty(), "{what}");
                assert_points(&read.value, &whole, 0..COUNT, &what);
            }
            if packing == Packing::Plain {
                // Where the bounds do not bear out what follows, the count is believed.
                let mut bytes = sound.clone();
                set_count(&mut bytes, format, 800);
                bytes[179..187].copy_from_slice(&12.0f64.to_le_bytes());
                assert_points(&read_bytes(&bytes).unwrap().value, &whole, 0..800, "neither");
            }
            let mut bytes = sound.clone();
            bytes[179..187].copy_from_slice(&12.0f64.to_le_bytes());
            let read = read_bytes(&bytes).unwrap();
            assert_eq!(
                warnings(&read),
                ["the bounds in its header are wrong; those of its points are used"]
            );
            assert_points(&read.value, &whole, 0..COUNT, "bounds");
        }
    }
}

#[test]
fn a_scale_that_its_bounds_do_not_bear_out_is_told() {
    let sound = file(PACKED[0], 0, Packing::Plain);
    let number = |at: usize| f64::from_le_bytes(sound[at..at + 8].try_into().unwrap());
    let told = |changes: &[(usize, f64)]| -> String {
        let mut bytes = sound.clone();
        for (at, value) in changes {
            bytes[*at..at + 8].copy_from_slice(&value.to_le_bytes());
        }
        warnings(&read_bytes(&bytes).unwrap()).join("\n")
    };
    // Scales of x, y and z begin at byte 131, offsets at 155, greatest and least values at 179.
    insta::assert_snapshot!(told(&[(131, 0.01)]), @"its points are spread 10 times as far in x as the bounds in its header: if these are right, its scale is wrong, and so are all sizes; export it anew with a scale of [0.001] there in place of [0.01]");
    let times = |k: f64| [131, 139, 147].map(|at| (at, k * 0.001));
    insta::assert_snapshot!(told(&times(100.0)), @"its points are spread 100 times as far in x, y, z as the bounds in its header: if these are right, its scale is wrong, and so are all sizes; export it anew with a scale of [0.001, 0.001, 0.001] there in place of [0.1, 0.1, 0.1]");
    for (k, said) in
        [(3.0, "spread 3 times"), (0.25, "spread 0.25 times"), (0.3048, "spread 0.3048 ")]
    {
        assert!(told(&times(k)).contains(said), "{k}: {}", told(&times(k)));
    }
    // In z alone.
    for k in [2.0, 0.5, 0.01] {
        let z = told(&[(147, k * 0.001)]);
        assert!(z.starts_with(&format!("its points are spread {k} times as far in z as")), "{z}");
    }
    // Heights far above the offset tell any factor; heights that begin at it may as well lack points.
    let mut high = sound.clone();
    let data = data_offset(&high);
    for record in high[data..].chunks_exact_mut(20) {
        let z = i32::from_le_bytes(record[8..12].try_into().unwrap()) + 300_000;
        record[8..12].copy_from_slice(&z.to_le_bytes());
    }
    for (at, by) in [(211, 300.0), (219, 300.0), (147, 0.0003)] {
        let value = number(at) + by;
        high[at..at + 8].copy_from_slice(&value.to_le_bytes());
    }
    let z = read_bytes(&high).unwrap();
    assert!(warnings(&z)[0].starts_with("its points are spread 1.3 times as far in z as"));
    assert_eq!(
        told(&[(147, 0.0013)]),
        "the bounds in its header are wrong; those of its points are used"
    );
}

#[test]
fn bounds_far_wider_than_the_points_are_told() {
    let mut bytes = file(PACKED[0], 0, Packing::Plain);
    bytes[179..187].copy_from_slice(&1e9f64.to_le_bytes());
    bytes[187..195].copy_from_slice(&(-1e9f64).to_le_bytes());
    insta::assert_snapshot!(warnings(&read_bytes(&bytes).unwrap()).join("\n"), @"the bounds in its header span [2000000000.0, 25.0, 20.0], its points [30.0, 25.0, 20.0]: those of its points are used");
}

#[test]
fn records_of_the_header_may_be_garbage() {
    let sound = file(3, 0, Packing::Fixed(700));
    let whole = read_bytes(&sound).unwrap().value;
    // The record tells a length past the points; its count is 0, or far too large.
    for (at, value) in [(227 + 20, vec![0xff; 2]), (100, vec![0; 4]), (100, vec![0xff; 4])] {
        let mut bytes = sound.clone();
        bytes[at..at + value.len()].copy_from_slice(&value);
        if at > 227 {
            // The length is needed then: the record is not the one that packs.
            bytes.splice(227..227, [[0; 20].as_slice(), &[0xff; 2], &[0; 32]].concat());
            let data = data_offset(&sound) as u32 + 54;
            bytes[96..100].copy_from_slice(&data.to_le_bytes());
            bytes[100..104].copy_from_slice(&2u32.to_le_bytes());
            bytes[227 + 54 + 20..227 + 54 + 22].copy_from_slice(&sound[247..249]);
            let table = table_at(&sound) as i64 + 54;
            bytes[data as usize..data as usize + 8].copy_from_slice(&table.to_le_bytes());
        }
        let read = read_bytes(&bytes).unwrap();
        assert_points(&read.value, &whole, 0..COUNT, "garbage records");
    }
}

#[test]
fn mutated_files_end_in_a_scan_or_one_clear_line() {
    let mut draws = Seed::new(17).draws();
    for format in PACKED {
        for packing in [Packing::Plain, Packing::Fixed(600), Packing::Varying] {
            let sound = file(format, 1, packing);
            let tail = if packing == Packing::Plain { 0 } else { sound.len() - table_at(&sound) };
            for round in 0..24 {
                let mut bytes = sound.clone();
                for _ in 0..1 + round % 3 {
                    let at = match round % 4 {
                        0 => draws.index(data_offset(&sound)),
                        1 => data_offset(&sound) + draws.index(80),
                        2 => bytes.len() - 1 - draws.index(tail.max(40)),
                        _ => draws.index(bytes.len()),
                    };
                    bytes[at] = [0, 0x7f, 0x80, 0xff, draws.bits() as u8][draws.index(5)];
                }
                match read_bytes(&bytes) {
                    Ok(read) => sound_enough(&read.value),
                    Err(error) => {
                        assert!(error.remedy_text().is_some(), "{error:?}");
                        assert!(!error.message().contains('\n'), "{error:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn real_scans_without_their_tables_lose_nothing() {
    let Some(data) = data() else { return };
    for name in ["lidR/Topography.laz", "lasR/bcts_1.laz", "spanner/ALS_Clip.laz"] {
        let sound = std::fs::read(data.join(name)).unwrap();
        let whole = read_bytes(&sound).unwrap().value;
        let (at, table) = (data_offset(&sound), table_at(&sound));
        let mut bytes = sound.clone();
        bytes[at..at + 8].fill(0xff);
        let n = whole.cloud.len();
        let read = read_bytes(&bytes).unwrap();
        assert!(!warnings(&read).is_empty());
        assert_points(&read.value, &whole, 0..n, name);
        let mut bytes = sound.clone();
        bytes[table + 8..].fill(7);
        assert_points(&read_bytes(&bytes).unwrap().value, &whole, 0..n, name);
        // One byte lost: the table, and the end of the last chunk with it.
        match read_bytes(&sound[..table - 1]) {
            Ok(read) => {
                let kept = read.value.cloud.len();
                assert!(kept < n && !warnings(&read).is_empty(), "{name}");
                assert_points(&read.value, &whole, 0..kept, name);
            }
            Err(error) => assert_eq!(name, "spanner/ALS_Clip.laz", "one chunk: {error:?}"),
        }
    }
}
