//! The six sections and the table of contents that follow the values.

use std::io::{self, Write};

use super::{Crate, HEAD, coding, counted};

const VERSION: [u8; 8] = [0, 8, 0, 0, 0, 0, 0, 0];

impl<W: Write> Crate<'_, W> {
    /// Writes them, and gives the bytes that the file begins with.
    pub(super) fn finish(mut self) -> io::Result<Vec<u8>> {
        let strings: Vec<u32> = std::mem::take(&mut self.strings.items);
        let tokens: Vec<u8> = self.tokens.items.iter().flat_map(|t| t.bytes().chain([0])).collect();
        let mut token_section = Vec::new();
        push(&mut token_section, self.tokens.items.len());
        push(&mut token_section, tokens.len());
        push_sized(&mut token_section, &coding::compressed(&tokens));

        let mut field_section = Vec::new();
        push(&mut field_section, self.fields.items.len());
        let names: Vec<u32> = self.fields.items.iter().map(|(name, _)| *name).collect();
        push_sized(&mut field_section, &coding::unsigned(&names));
        let reps: Vec<u8> =
            self.fields.items.iter().flat_map(|(_, rep)| rep.0.to_le_bytes()).collect();
        push_sized(&mut field_section, &coding::compressed(&reps));

        let mut set_section = Vec::new();
        push(&mut set_section, self.sets.len());
        push_sized(&mut set_section, &coding::unsigned(&self.sets));

        let mut path_section = Vec::new();
        let [numbers, names, jumps] = self.paths.tree();
        push(&mut path_section, numbers.len());
        push(&mut path_section, numbers.len());
        for column in [&numbers, &names, &jumps] {
            push_sized(&mut path_section, &coding::ints(column));
        }

        let mut spec_section = Vec::new();
        push(&mut spec_section, self.specs.len());
        for k in 0..3 {
            let column: Vec<u32> = self.specs.iter().map(|spec| spec[k]).collect();
            push_sized(&mut spec_section, &coding::unsigned(&column));
        }

        let sections = [
            ("TOKENS", token_section),
            ("STRINGS", counted(&strings, u32::to_le_bytes)),
            ("FIELDS", field_section),
            ("FIELDSETS", set_section),
            ("PATHS", path_section),
            ("SPECS", spec_section),
        ];
        let mut contents = Vec::new();
        push(&mut contents, sections.len());
        for (name, bytes) in &sections {
            let mut padded = [0; 16];
            padded[..name.len()].copy_from_slice(name.as_bytes());
            contents.extend(padded);
            contents.extend(self.at.to_le_bytes());
            contents.extend((bytes.len() as u64).to_le_bytes());
            self.bytes(bytes)?;
        }
        let contents_at = self.at;
        self.bytes(&contents)?;

        let mut head = b"PXR-USDC".to_vec();
        head.extend(VERSION);
        head.extend(contents_at.to_le_bytes());
        head.resize(HEAD, 0);
        self.out.flush()?;
        Ok(head)
    }
}

fn push(out: &mut Vec<u8>, number: usize) {
    out.extend((number as u64).to_le_bytes());
}

fn push_sized(out: &mut Vec<u8>, bytes: &[u8]) {
    push(out, bytes.len());
    out.extend(bytes);
}
