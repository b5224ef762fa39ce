//! Literals of an Xtensa assembly text where their loads reach them.
//!
//! `l32r` loads a word that lies at most 256 KiB before it. LLVM 22 writes the literals of a function before the function's own
//! section begins, so that they land in that of the function before. Here each goes, aligned, into a section of literals
//! that stands before the section of its code and is named as linker scripts expect it.

use std::fmt::Write;

/// Literals of a function that LLVM made: they stand before the section of their function.
const OF_NEXT_FUNCTION: &str = ".LCPI";

/// Returns the section of the literals of a section of code.
fn literal_section(code: &str) -> String {
    match code.strip_prefix(".text") {
        Some(rest) => format!(".literal{rest}"),
        None => format!("{code}.literal"),
    }
}

/// A directive that changes the section.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Change<'a> {
    To { section: &'a str, is_code: bool, pushes: bool },
    Back,
}

/// Reads `.text`, `.section NAME,"FLAGS"`, `.pushsection NAME,"FLAGS"` or `.popsection`.
fn change(line: &str) -> Option<Change<'_>> {
    let (directive, rest) = line.split_once([' ', '\t']).unwrap_or((line, ""));
    let pushes = match directive {
        ".text" => return Some(Change::To { section: ".text", is_code: true, pushes: false }),
        ".data" | ".bss" => {
            return Some(Change::To { section: directive, is_code: false, pushes: false });
        }
        ".popsection" => return Some(Change::Back),
        ".section" => false,
        ".pushsection" => true,
        _ => return None,
    };
    let mut words = rest.trim().splitn(2, ',');
    let section = words.next().unwrap_or_default().trim().trim_matches('"');
    let flags = words.next().and_then(|rest| rest.split('"').nth(1));
    // Without flags, they are those of the name.
    let is_code = flags.map_or(section.starts_with(".text"), |flags| flags.contains('x'));
    Some(Change::To { section, is_code, pushes })
}

/// Reads `.literal NAME, VALUE`.
fn literal(line: &str) -> Option<(&str, &str)> {
    let rest = line.strip_prefix(".literal")?;
    let (name, value) = rest.strip_prefix([' ', '\t'])?.split_once(',')?;
    let value = value.split("//").next().unwrap_or_default();
    Some((name.trim(), value.trim()))
}

/// Returns a literal as a word of data.
fn word(name: &str, value: &str) -> String {
    format!("{name}:\n.4byte {value}\n")
}

/// Returns whether a line defines a symbol, as a function begins.
fn is_label(line: &str) -> bool {
    line.ends_with(':') && !line.starts_with([' ', '\t'])
}

/// A section that a text is in: its name where it holds code.
type Place = Option<String>;

struct Mover {
    moved: String,
    place: Place,
    /// Places that `.pushsection` left.
    left: Vec<Place>,
    /// Literals of the function that follows, in whichever section that will be.
    waiting: String,
}

impl Mover {
    fn line(&mut self, line: &str) {
        let trimmed = line.trim();
        match change(trimmed) {
            Some(Change::Back) => self.place = self.left.pop().flatten(),
            Some(Change::To { section, is_code, pushes }) => {
                let place = is_code.then(|| section.to_owned());
                let before = std::mem::replace(&mut self.place, place);
                if pushes {
                    self.left.push(before);
                }
                // Sections are laid out in the order in which they first appear.
                self.put("");
            }
            None => {}
        }
        match literal(trimmed) {
            Some((name, value)) if name.starts_with(OF_NEXT_FUNCTION) => {
                self.waiting.push_str(&word(name, value));
            }
            Some((name, value)) if self.place.is_some() => self.put(&word(name, value)),
            None if trimmed == ".literal_position" => {}
            _ => {
                if is_label(line) && self.place.is_some() && !self.waiting.is_empty() {
                    let waiting = std::mem::take(&mut self.waiting);
                    self.put(&waiting);
                }
                self.moved.push_str(line);
                self.moved.push('\n');
            }
        }
    }

    /// Writes literals into the section of the literals of this place, where that holds code.
    fn put(&mut self, literals: &str) {
        let Some(code) = &self.place else { return };
        let section = literal_section(code);
        // Writing to a string never fails.
        let _ = write!(
            self.moved,
            ".pushsection {section},\"ax\",@progbits\n.p2align 2\n{literals}.popsection\n"
        );
    }
}

/// Returns the text with its literals moved.
#[must_use]
pub fn moved(text: &str) -> String {
    let mut mover = Mover {
        moved: String::with_capacity(2 * text.len()),
        place: Some(".text".to_owned()),
        left: Vec::new(),
        waiting: String::new(),
    };
    for line in text.lines() {
        mover.line(line);
    }
    mover.moved
}
