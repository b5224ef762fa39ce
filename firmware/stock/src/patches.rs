//! Packages whose assembly LLVM does not take: what is compiled in place of a few words of theirs.
//!
//! The compiler applies these to the text that it has read. No file is changed, nor is the lock file.

use std::fmt;
use std::path::Path;

/// Words of a package's source, and what is compiled in their place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patch {
    /// The package's name.
    pub package: &'static str,
    /// The one version that holds the words.
    pub version: &'static str,
    /// The file, from the package's folder.
    pub file: &'static str,
    from: &'static str,
    to: &'static str,
}

/// All of them.
pub const PATCHES: [Patch; 2] = [
    // No external registers (`rer`) in LLVM: no debugger is seen, which `panic` would stop for.
    Patch {
        package: "xtensa-lx",
        version: "0.13.0",
        file: "src/lib.rs",
        from: r#"unsafe { asm!("rer {0}, {1}", out(reg) x, in(reg) XDM_OCD_DCR_SET, options(nostack)) };"#,
        to: "x = XDM_OCD_DCR_SET & 0;",
    },
    // No symbol as the constant of a branch in LLVM: its number, which stands in the same file.
    Patch {
        package: "xtensa-lx-rt",
        version: "0.23.0",
        file: "src/exception/asm.rs",
        from: "bnei    a6, EXCCAUSE_LEVEL1_INTERRUPT,",
        to: "bnei    a6, 4,",
    },
];

/// A patch that does not fit its package any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unfit {
    patch: Patch,
    version: String,
}

impl fmt::Display for Unfit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { patch: Patch { package, version, file, from, .. }, version: found } = self;
        write!(
            formatter,
            "the patch of {package} {version} does not fit version {found}, whose {file} has to hold once:\n{from}\n\
             renew firmware/stock/src/patches.rs"
        )
    }
}

impl std::error::Error for Unfit {}

/// Returns the text of a file of a package as it is to be compiled.
///
/// # Errors
/// Where a patch is for this file, and for another version or other words.
pub fn patched(package: &str, version: &str, file: &Path, text: String) -> Result<String, Unfit> {
    let mut patched = text;
    for patch in
        PATCHES.iter().filter(|patch| patch.package == package && file.ends_with(patch.file))
    {
        if patch.version != version || patched.matches(patch.from).count() != 1 {
            return Err(Unfit { patch: *patch, version: version.to_owned() });
        }
        patched = patched.replace(patch.from, patch.to);
    }
    Ok(patched)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATCH: Patch = PATCHES[0];

    fn apply(version: &str, file: &str, text: &str) -> Result<String, Unfit> {
        patched(PATCH.package, version, Path::new(file), text.to_owned())
    }

    #[test]
    fn the_words_of_its_package_are_replaced_and_no_others() {
        let text = format!("before {} after", PATCH.from);
        let file = "/registry/xtensa-lx-0.13.0/src/lib.rs";
        assert_eq!(
            apply(PATCH.version, file, &text).unwrap(),
            format!("before {} after", PATCH.to)
        );
        assert_eq!(apply(PATCH.version, "/registry/x/src/main.rs", &text).unwrap(), text);
        assert_eq!(patched("other", "1.0.0", Path::new(file), text.clone()).unwrap(), text);
    }

    #[test]
    fn another_version_or_other_words_are_refused_and_named() {
        let (file, text) = (PATCH.file, PATCH.from);
        for (version, text) in
            [("0.14.0", text), (PATCH.version, ""), (PATCH.version, &text.repeat(2))]
        {
            let message = apply(version, file, text).unwrap_err().to_string();
            assert!(message.contains(&format!("does not fit version {version}")), "{message}");
        }
    }
}
