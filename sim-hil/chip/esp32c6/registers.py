"""Writes registers.txt: names, offsets and reset values of the ESP32-C6's registers.

The facts are taken from the source of the PAC crate `esp32c6` (by esp-rs, made from Espressif's SVD), where cargo
keeps it: `cargo fetch --target riscv32imac-unknown-none-elf`, then `python3 sim-hil/chip/esp32c6/registers.py`.
Blocks that a robot never touches (cryptography, other buses) are left out.
"""

import glob
import os
import re

VERSION = "0.24.0"
HERE = os.path.dirname(os.path.abspath(__file__))
LEFT_OUT = """AES ATOMIC CLINT DMA DS ECC HINF HMAC HP_SYS I2S0 IEEE802154 LEDC LP_I2C0 LP_I2C_ANA_MST LP_TEE LP_UART
MEM_MONITOR OTP_DEBUG PARL_IO PAU PCNT PLIC_UX RMT RSA SHA SLC SLCHOST SOC_ETM TEE TRACE TWAI0 TWAI1 UART1 UHCI0
EXTMEM SPI0""".split()

CARGO = os.environ.get("CARGO_HOME") or os.path.expanduser("~/.cargo")
source = glob.glob(f"{CARGO}/registry/src/*/esp32c6-{VERSION}/src")[0]
ACCESSOR = re.compile(
    r'#\[doc = "(0x[0-9a-f]+)(?:\.\.(0x[0-9a-f]+))? - ([^\n]*)"\]\n(?:\s*#\[[^\n]*\n|\s*///[^\n]*\n)*'
    r"\s*pub const fn (\w+)\(&self(, n: usize)?\) -> &(?:crate::)?(?:(\w+)::)?(\w+)"
)


def read(path):
    with open(path, encoding="utf-8") as file:
        return file.read()


def reset_value(path):
    found = re.search(r"RESET_VALUE: u\d+ = (0x[0-9a-f_]+|\d+)", read(path)) if os.path.exists(path) else None
    return int(found.group(1).replace("_", ""), 0) if found else 0


def registers(path, offset, prefix):
    """Yields (offset, count, stride, reset value, name) of every register of a block."""
    text = read(path + ".rs")
    for first, last, doc, name, indexed, _, kind in ACCESSOR.findall(text):
        first, last = int(first, 16), int(last, 16) if last else None
        field = re.search(r"\b" + name + r": \[(\w+); (0x[0-9a-f]+|\d+)\]", text)
        count = int(field.group(2), 0) if field and indexed else 1
        stride = (last - first) // count if last else 4
        kind = kind.lower()
        if "Cluster" in doc or os.path.isdir(f"{path}/{kind}") and not os.path.exists(f"{path}/{name}.rs"):
            for index in range(count):
                inner = f"{prefix}{name}{index if count > 1 else ''}."
                yield from registers(f"{path}/{kind}", offset + first + stride * index, inner)
        else:
            file = next((f"{path}/{it}.rs" for it in (kind, name) if os.path.exists(f"{path}/{it}.rs")), "")
            yield offset + first, count, stride, reset_value(file), prefix + name


with open(HERE + "/registers.txt", "w", encoding="utf-8") as out:
    print(f"# Written by registers.py from the crate esp32c6 {VERSION}: do not edit.", file=out)
    print("# Block and base, then: offset, reset value, name [count, stride].", file=out)
    for name, module, base in re.findall(
        r"pub type (\w+) = crate::Periph<(\w+)::RegisterBlock, (0x[0-9a-f_]+)>", read(source + "/lib.rs")
    ):
        if name in LEFT_OUT:
            continue
        print(f"{name} {base.replace('_', '')}", file=out)
        seen = set()
        for offset, count, stride, reset, register in sorted(
            registers(f"{source}/{module}", 0, ""), key=lambda it: (it[0], -it[1])
        ):
            if offset in seen:
                continue
            seen.update(offset + stride * index for index in range(count))
            array = f" {count} {stride:x}" if count > 1 else ""
            print(f"{offset:x} {reset:x} {register}{array}", file=out)
