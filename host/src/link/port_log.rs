//! The text that a serial port sends besides answers, and the cause that the text names.

use std::fmt;

use crate::system::text::printable;

/// Bytes of the end of the text that are kept: two starts of a chip.
const KEPT: usize = 4096;
/// Lines that are shown.
const SHOWN: usize = 4;
/// Starts within the wait for an answer that are a loop: opening the port causes one.
const LOOP: usize = 3;
/// Least share of printable characters of a text.
const TEXT: f64 = 0.8;

/// Phrases of a chip's ROM, boot loader and firmware, each with its cause and the remedy; the first that matches counts.
const CAUSES: [(&[&str], &str); 6] = [
    (
        &["brownout", "brown_out", "brown-out"],
        "the chip's supply breaks down (brown-out): charge the battery, or take a stronger supply and a shorter cable",
    ),
    (
        &["waiting for download", "download_boot", "(download("],
        "the chip waits for firmware (download mode): release the boot button, then press reset",
    ),
    (
        &["invalid header: 0xffffffff", "flash read err", "no bootable app"],
        "the chip's flash holds no firmware, or holds it at another address: flash the robot's image with its boot loader",
    ),
    (
        &["invalid header", "invalid segment", "checksum", "image hash", "verification failed"],
        "the firmware in flash is damaged, or is for another chip: flash it again",
    ),
    (
        &["flix-walker", "older than revision"],
        "the robot's firmware starts and takes no question; its own lines say why",
    ),
    (&["micropython", "circuitpython", "arduino", "esphome", "wled", "tasmota"], FOREIGN),
];
const FOREIGN: &str = "another firmware or another device is at this port: flash the robot's firmware, or name another port";
const SILENT: &str = "check the cable, that the robot's firmware is flashed, and that no other program has the port open";

/// The end of the text that a port has sent.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PortLog(Vec<u8>);

impl PortLog {
    /// Takes the bytes that arrived next.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
        self.0.drain(..self.0.len().saturating_sub(KEPT));
    }

    /// Returns cause and remedy of a missing answer.
    fn cause(&self) -> &'static str {
        let text = String::from_utf8_lossy(&self.0).to_lowercase();
        let named = CAUSES.iter().find(|(phrases, _)| phrases.iter().any(|it| text.contains(it)));
        let is_printable = |it: &char| {
            *it != char::REPLACEMENT_CHARACTER && (!it.is_control() || it.is_whitespace())
        };
        let printable = text.chars().filter(is_printable).count();
        if text.is_empty() {
            SILENT
        } else if let Some((_, cause)) = named {
            cause
        } else if text.matches("rst:0x").count() >= LOOP {
            "the chip restarts again and again (boot loop): its last lines name the reason; flash it again"
        } else if (printable as f64) < TEXT * text.chars().count() as f64 {
            "the port carries bytes that are no text: it belongs to another device, or to a chip that sends at another rate"
        } else {
            FOREIGN
        }
    }

    /// Returns the last lines with a letter or digit, oldest first.
    fn lines(&self) -> Vec<String> {
        let text = String::from_utf8_lossy(&self.0);
        let is_word = |line: &&str| line.chars().any(char::is_alphanumeric);
        let lines = text.lines().map(str::trim).filter(is_word);
        let mut last: Vec<_> =
            lines.rev().take(SHOWN).map(|line| printable(line).into_owned()).collect();
        last.reverse();
        last
    }
}

impl fmt::Display for PortLog {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.cause())?;
        let lines = self.lines();
        if !lines.is_empty() {
            f.write_str("; the port sent last:")?;
        }
        lines.iter().try_for_each(|line| write!(f, "\n    {line}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &[u8]) -> String {
        let mut log = PortLog::default();
        text.chunks(7).for_each(|chunk| log.extend(chunk));
        log.to_string()
    }

    #[test]
    fn a_port_without_an_answer_is_explained_by_its_text() {
        let rom = "ESP-ROM:esp32c6-20220919\r\nBuild:Sep 19 2022\r\nrst:0x1 (POWERON),boot:0xc\r\n";
        for (text, word, line) in [
            (
                "rst:0x1 (POWERON_RESET)\r\ninvalid header: 0xffffffff\r\n".repeat(9),
                "holds no firmware",
                "invalid header",
            ),
            (format!("{rom}invalid header: 0xffffffff\r\n"), "holds no firmware", "0xffffffff"),
            (
                "flash read err, 1000\r\nets_main.c 371\r\n".to_owned(),
                "holds no firmware",
                "ets_main",
            ),
            (
                "boot:0x3 (DOWNLOAD_BOOT(UART0/UART1/SDIO))\r\nwaiting for download\r\n".to_owned(),
                "download mode",
                "waiting",
            ),
            (format!("{rom}waiting for download"), "download mode", "waiting"),
            (
                "\r\nBrownout detector was triggered\r\n\r\nets Jul 29 2019\r\n".to_owned(),
                "brown-out",
                "triggered",
            ),
            ("rst:0xf (RTCWDT_BROWN_OUT_RESET)\r\n".to_owned(), "brown-out", "BROWN_OUT"),
            (rom.repeat(5), "boot loop", "rst:0x1"),
            (
                "E (52) boot: image at 0x10000 has invalid magic byte, checksum failed".to_owned(),
                "damaged",
                "magic",
            ),
            (
                "flix-walker 0.2.0 on generic\r\nthis ESP32 is older than revision 3\r\n"
                    .to_owned(),
                "own lines",
                "revision 3",
            ),
            ("MicroPython v1.22 on 2024\r\n>>> ".to_owned(), "another firmware", "MicroPython"),
            ("sensor reads 21.5 C\r\n".repeat(30), "another firmware", "21.5"),
            ("\u{1}\u{2}\u{fffd}\u{80}\u{3}a".to_owned(), "no text", "a"),
        ] {
            let said = said(text.as_bytes());
            assert!(said.contains(word) && said.contains(line), "{text:?}: {said}");
            assert!(said.lines().count() <= 1 + SHOWN, "{said}");
        }
        assert!(said(b"").contains("check the cable"));
        assert!(said(&[0xff; 9000]).contains("no text"));
    }

    #[test]
    fn nothing_that_a_port_sends_controls_the_terminal() {
        let said = said(b"\x1b[2Jhello\x07\r\n\x9b31mworld");
        assert!(said.chars().all(|it| !it.is_control() || it == '\n'), "{said:?}");
        assert!(said.contains("hello") && said.contains("world"));
    }
}
