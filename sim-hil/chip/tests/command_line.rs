//! What `flix-chip` does with files that are no image.

use std::io::Write;
use std::process::Command;

#[test]
fn a_file_that_is_no_image_is_refused_in_a_sentence() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::temp_dir().join(format!("flix-chip-{}.elf", std::process::id()));
    std::fs::File::create(&path)?.write_all(b"not an image")?;
    let output = Command::new(env!("CARGO_BIN_EXE_flix-chip")).arg(&path).output();
    std::fs::remove_file(&path)?;
    let output = output?;
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.starts_with("error: the image is no ELF file"), "{message}");
    Ok(())
}
