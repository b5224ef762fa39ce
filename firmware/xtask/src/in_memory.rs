//! What the fast loop of an ESP32's image executes of flash: followed from its interrupt's handler, by the calls and the
//! addresses in each function's code, as no core runs the whole image.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::Range;

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::run::{self, Error};

/// The handler, as esp-hal's macro calls it.
const HANDLER: &str = "__esp_hal_internal_on_tick";
/// Flash that the cache maps for instructions (ESP32 technical reference manual, "Embedded Memory").
const FLASH: Range<u32> = 0x400d_0000..0x4040_0000;
/// Names of functions that stay in flash, by which nothing is followed: panics with their words, and what the loop executes
/// while it aligns or tries a motor, or takes settings over.
const ELSEWHERE: [&str; 9] = [
    "panic",
    "core3fmt",
    "unwrap_failed",
    "len_mismatch_fail",
    "7Control5align",
    "7Control7try_out",
    "7Control8tabulate",
    "7Control9configure",
    "7Control14begin_aligning",
];

/// A function: its name and its code.
struct Function<'a> {
    name: &'a str,
    code: &'a [u8],
}

/// An image, by address.
struct Image<'a> {
    functions: BTreeMap<u32, Function<'a>>,
    loaded: Vec<(u32, &'a [u8])>,
}

impl<'a> Image<'a> {
    fn of(file: &'a object::File<'a>) -> Self {
        let loaded = file.sections().filter_map(|section| {
            Some((u32::try_from(section.address()).ok()?, section.data().ok()?))
        });
        let loaded: Vec<_> = loaded.filter(|(address, _)| *address != 0).collect();
        let functions = file.symbols().filter(|it| it.kind() == SymbolKind::Text);
        let functions = functions.filter_map(|symbol| {
            let address = u32::try_from(symbol.address()).ok()?;
            let length = usize::try_from(symbol.size()).ok().filter(|length| *length > 0)?;
            let code = bytes(&loaded, address, length)?;
            Some((address, Function { name: symbol.name().ok()?, code }))
        });
        Self { functions: functions.collect(), loaded }
    }

    fn word(&self, address: u32) -> Option<u32> {
        let word = bytes(&self.loaded, address, 4)?;
        word.try_into().ok().map(u32::from_le_bytes)
    }

    /// Returns the functions in flash that the handler reaches, each with its caller, and how many it reaches at all.
    fn reached(&self) -> Result<(Vec<String>, usize), Error> {
        let handler = self.functions.iter().find(|(_, it)| it.name.contains(HANDLER));
        let Some((first, _)) = handler else {
            return Err(Error::Sentence(format!(
                "the image lacks {HANDLER}: nothing was looked at"
            )));
        };
        let mut callers = BTreeMap::from([(*first, HANDLER)]);
        let mut left = vec![*first];
        while let Some(address) = left.pop() {
            let Some(function) = self.functions.get(&address) else { continue };
            for named in named(address, function.code) {
                let target = match named {
                    Named::Call(target) => Some(target),
                    Named::Literal(place) => self.word(place),
                };
                let Some(target) = target.filter(|it| self.stays(*it)) else { continue };
                if let Entry::Vacant(caller) = callers.entry(target) {
                    caller.insert(function.name);
                    left.push(target);
                }
            }
        }
        let in_flash = callers.iter().filter(|(address, _)| FLASH.contains(address));
        let names = in_flash.filter_map(|(address, caller)| {
            Some(format!("{} (from {caller})", self.functions.get(address)?.name))
        });
        Ok((names.collect(), callers.len()))
    }

    /// Returns whether a function begins here that is to be in working memory with all that it calls.
    fn stays(&self, address: u32) -> bool {
        let function = self.functions.get(&address);
        function.is_some_and(|it| !ELSEWHERE.iter().any(|part| it.name.contains(part)))
    }
}

fn bytes<'a>(loaded: &[(u32, &'a [u8])], address: u32, length: usize) -> Option<&'a [u8]> {
    loaded.iter().find_map(|(begin, data)| {
        let from = usize::try_from(address.checked_sub(*begin)?).ok()?;
        data.get(from..from.checked_add(length)?)
    })
}

/// What an instruction names.
#[derive(Debug, PartialEq, Eq)]
enum Named {
    /// It calls what begins here.
    Call(u32),
    /// It loads the word at this address.
    Literal(u32),
}

/// Returns what the code of a function at this address names (Xtensa Instruction Set Architecture Reference Manual: CALLn,
/// L32R; an instruction takes two bytes where the lowest four bits are 8 or more, else three).
fn named(mut address: u32, mut code: &[u8]) -> Vec<Named> {
    let mut found = Vec::new();
    while let [first, rest @ ..] = code {
        let length = if first & 15 < 8 { 3 } else { 2 };
        if let (3, [second, third, ..]) = (length, rest) {
            let word = u32::from_le_bytes([*first, *second, *third, 0]);
            match first & 15 {
                5 => {
                    let distance = ((word >> 6) << 14).cast_signed() >> 12;
                    found.push(Named::Call((address & !3).wrapping_add_signed(distance + 4)));
                }
                1 => {
                    let distance = ((word >> 8) | 0xffff_0000) << 2;
                    found.push(Named::Literal(
                        (address.wrapping_add(3) & !3).wrapping_add(distance),
                    ));
                }
                _ => {}
            }
        }
        code = code.get(length..).unwrap_or_default();
        address = address.wrapping_add(length as u32);
    }
    found
}

/// Looks at an image, and says what it has seen.
pub(crate) fn check(elf: &[u8]) -> Result<String, Error> {
    let (in_flash, reached) = Image::of(&run::elf(elf)?).reached()?;
    if in_flash.is_empty() {
        return Ok(format!("the fast loop's {reached} functions are in working memory"));
    }
    Err(Error::Sentence(format!(
        "the fast loop executes {} of its {reached} functions from flash; name them in in_memory.x: {}",
        in_flash.len(),
        in_flash.join(", ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: u32 = 0x4008_0400;
    const HELPER: u32 = 0x400d_1000;
    const PANIC: u32 = 0x400d_2000;

    /// `call8 target` at an address, as the manual encodes it.
    fn call(from: u32, target: u32) -> [u8; 3] {
        let distance = target.wrapping_sub((from & !3) + 4) >> 2;
        let [first, second, third, _] = ((distance & 0x3_ffff) << 6 | 0b10_0101).to_le_bytes();
        [first, second, third]
    }

    fn functions(code: &[u8]) -> Image<'_> {
        let entry: &[u8] = &[0x36, 0x41, 0x00];
        let functions =
            [(TICK, HANDLER, code), (HELPER, "helper", entry), (PANIC, "a_panic", entry)];
        let functions = functions.map(|(address, name, code)| (address, Function { name, code }));
        Image { functions: functions.into(), loaded: vec![(TICK, code)] }
    }

    #[test]
    fn what_is_called_in_flash_is_named_with_its_caller() {
        // entry; a narrow move; the call; return.
        let mut code = vec![0x36, 0x41, 0x00, 0x0c, 0x02];
        code.extend(call(TICK + 5, HELPER));
        code.extend([0x1d, 0xf0]);
        let (in_flash, reached) = functions(&code).reached().unwrap();
        assert_eq!(in_flash, [format!("helper (from {HANDLER})")]);
        assert_eq!(reached, 2);
    }

    #[test]
    fn what_is_called_by_an_address_is_found_too() {
        // entry; `l32r a8` of the word before the function.
        let code = [0x36, 0x41, 0x00, 0x81, 0xfe, 0xff];
        assert_eq!(named(TICK, &code), [Named::Literal(TICK - 4)]);
        let literal = HELPER.to_le_bytes();
        let image = Image { loaded: vec![(TICK - 4, &literal)], ..functions(&code) };
        assert_eq!(image.reached().unwrap().0.len(), 1);
    }

    #[test]
    fn panics_may_lie_in_flash() {
        let code = call(TICK, PANIC);
        assert_eq!(functions(&code).reached().unwrap().0, Vec::<String>::new());
    }
}
