//! The store of releases up to this one's: a map of crate `sequential-storage`, written here as those releases wrote it.

use embassy_embedded_hal::adapter::BlockingAsync;
use embassy_futures::block_on;
use sequential_storage::Error;
use sequential_storage::cache::Cache;
use sequential_storage::map::{MapConfig, MapStorage};

use super::super::model::{Flash, PowerGone, SECTOR, SECTORS};

const SWEEP: u8 = 254;
const FILLER: u8 = 255;
const FILLER_LENGTH: usize = 960;
const LONGEST: usize = 1024;

type Outcome = Result<(), Error<PowerGone>>;

pub(super) fn save(flash: &mut Flash, key: u8, bytes: &[u8]) -> Outcome {
    let config = MapConfig::try_new(0..(SECTOR * SECTORS) as u32).unwrap();
    let mut map = MapStorage::new(BlockingAsync::new(flash), config, Cache::new_uncached());
    let mut scratch = [0; LONGEST];
    match block_on(map.store_item(&mut scratch, &key, &bytes)) {
        Err(Error::Corrupted { .. }) => {
            block_on(map.erase_all())?;
            block_on(map.store_item(&mut scratch, &key, &bytes))
        }
        outcome => outcome,
    }
}

pub(super) fn save_and_sweep(flash: &mut Flash, key: u8, bytes: &[u8]) -> Outcome {
    save(flash, SWEEP, &[0])?;
    save(flash, key, bytes)?;
    for _ in 0..=(SECTORS + 1) * SECTOR / FILLER_LENGTH {
        save(flash, FILLER, &[0; FILLER_LENGTH])?;
    }
    save(flash, FILLER, &[])?;
    save(flash, SWEEP, &[1])
}
