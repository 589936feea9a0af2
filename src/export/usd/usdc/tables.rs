//! Names, paths and the like, each once and by its number.

use std::collections::HashMap;

/// Each item once, by its number.
pub(super) struct Table<T> {
    pub items: Vec<T>,
    numbers: HashMap<T, u32>,
}

impl<T> Default for Table<T> {
    fn default() -> Self {
        Table { items: Vec::new(), numbers: HashMap::new() }
    }
}

impl<T: Clone + Eq + std::hash::Hash> Table<T> {
    pub fn number(&mut self, item: T) -> u32 {
        if let Some(number) = self.numbers.get(&item) {
            return *number;
        }
        let number = self.items.len() as u32;
        self.items.push(item.clone());
        self.numbers.insert(item, number);
        number
    }
}

/// The paths of a file as a tree; 0 is its root.
pub(super) struct Paths {
    /// Parent, and the token of the last element; negative for a property's.
    numbers: HashMap<(u32, i32), u32>,
    elements: Vec<i32>,
    children: Vec<Vec<u32>>,
}

impl Default for Paths {
    fn default() -> Self {
        Paths { numbers: HashMap::new(), elements: vec![0], children: vec![Vec::new()] }
    }
}

impl Paths {
    pub const ROOT: u32 = 0;

    pub fn number(&mut self, parent: u32, token: u32, is_property: bool) -> u32 {
        let element = if is_property { -(token as i32) } else { token as i32 };
        let next = self.elements.len() as u32;
        let number = *self.numbers.entry((parent, element)).or_insert(next);
        if number == next {
            self.elements.push(element);
            self.children.push(Vec::new());
            self.children[parent as usize].push(next);
        }
        number
    }

    /// Paths, each before what is below it: their numbers, their elements, and where the next
    /// sibling is: so many entries on; 0 for the next entry, of a path without children; −1 for
    /// none, of a path with children; −2 for neither.
    pub fn tree(&self) -> [Vec<i32>; 3] {
        let mut out = [Vec::new(), Vec::new(), Vec::new()];
        // Whether a sibling follows.
        let mut waiting = vec![(Paths::ROOT, false)];
        // Entries whose sibling is still to come, by depth of the stack under them.
        let mut open: Vec<(usize, usize)> = Vec::new();
        while let Some((path, has_sibling)) = waiting.pop() {
            let at = out[0].len();
            while let Some((_, entry)) = open.pop_if(|(depth, _)| *depth > waiting.len()) {
                out[2][entry] = (at - entry) as i32;
            }
            let children = &self.children[path as usize];
            out[0].push(path as i32);
            out[1].push(self.elements[path as usize]);
            out[2].push(match (has_sibling, children.is_empty()) {
                (true, true) => 0,
                (true, false) => {
                    open.push((waiting.len(), at));
                    0
                }
                (false, false) => -1,
                (false, true) => -2,
            });
            let last = children.len().saturating_sub(1);
            waiting.extend(children.iter().enumerate().rev().map(|(k, c)| (*c, k < last)));
        }
        out
    }
}
