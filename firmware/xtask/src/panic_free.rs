//! Whether a panic can be reached from the fast tick: it is linked alone, and were one reachable, the
//! panic handler would be linked with it.

use object::{Object, ObjectSymbol, SymbolKind};

use crate::run::{self, Error};
use crate::toolchain;

/// What the panic handler of that image calls.
const HANDLER: &str = "flix_panic_is_reachable";
/// The tick, as that image calls it.
const TICK: &str = "fast_tick";

/// Returns whether a symbol marks a place for the assembler alone: a local label, or code begun or ended.
fn is_mark(name: &str) -> bool {
    name.is_empty() || name.starts_with(['.', '$'])
}

/// Names of the symbols that an image defines.
fn symbols(elf: &[u8]) -> Result<Vec<String>, Error> {
    let file = run::elf(elf)?;
    let kinds = [SymbolKind::Text, SymbolKind::Unknown];
    let defined =
        file.symbols().filter(|symbol| !symbol.is_undefined() && kinds.contains(&symbol.kind()));
    let names = defined.filter_map(|symbol| symbol.name().ok());
    Ok(names.filter(|name| !is_mark(name)).map(str::to_owned).collect())
}

/// Builds the tick alone and looks.
pub(crate) fn run() -> Result<(), Error> {
    run::run(toolchain::riscv("build")?.args(["--package", "flix-firmware"]).args([
        "--bin",
        "fast-tick",
        "--features",
        "pil",
    ]))?;
    let symbols = symbols(&run::read(&toolchain::riscv_binary("fast-tick"))?)?;
    verdict(&symbols)?;
    println!("no panic can be reached from the fast tick ({} functions linked)", symbols.len());
    Ok(())
}

fn verdict(symbols: &[String]) -> Result<(), Error> {
    if !symbols.iter().any(|name| name == TICK) {
        return Err(Error::Sentence(format!("the image lacks {TICK}: nothing was looked at")));
    }
    let panics: Vec<_> = symbols
        .iter()
        .filter(|name| *name == HANDLER || name.contains("panic") || name.contains("begin_unwind"))
        .map(String::as_str)
        .collect();
    if panics.is_empty() {
        return Ok(());
    }
    Err(Error::Sentence(format!(
        "a panic can be reached from the fast tick, by way of {}: look for indexing, division, \
         slicing or an unwrap in what `Control::tick` calls",
        panics.join(", ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn the_tick_alone_passes() {
        assert!(verdict(&names(&[TICK, "memcpy"])).is_ok());
    }

    #[test]
    fn a_panic_beside_it_fails() {
        assert!(verdict(&names(&[TICK, "_ZN4core9panicking18panic_bounds_check"])).is_err());
        assert!(verdict(&names(&[TICK, HANDLER])).is_err());
    }

    #[test]
    fn an_image_without_the_tick_fails() {
        assert!(verdict(&names(&["memcpy"])).is_err());
    }
}
