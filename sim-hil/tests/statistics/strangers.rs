//! The learned controller steers robots that it has never seen.

use std::sync::Arc;
use std::time::Duration;

use flix_host::nav::{ControllerKind, Experience, Navigator, Path, Repertoire, Settings, Task};
use flix_host::pilot::steering::names;
use flix_host::pilot::{Ending, Pilot};
use flix_sim::experiment::course::{Conditions, Course};
use flix_sim::model::{RobotModel, stranger};

const LATENCY: Duration = Duration::from_millis(20);

#[test]
fn by_experience_alone_strangers_are_steered_along_a_circle_within_25_mm() {
    let path = Path::circle(0.4).unwrap();
    let experience = Arc::new(Experience::shipped());
    for seed in [31, 32] {
        let task = Task::Follow { path: path.clone(), laps: 1 };
        let settings = Settings { latency: LATENCY, ..Settings::for_task(&task) }
            .steered_by(ControllerKind::Learned);
        let repertoire = Repertoire::Experience(Arc::clone(&experience));
        let names = names(&repertoire.table());
        let navigator = Navigator::new(task, repertoire, settings).unwrap();
        let model = stranger(&RobotModel::named("W").unwrap(), seed);
        let conditions =
            Conditions { model, seed, latency: LATENCY, loss: 0.05, start: path.start() };
        let mut course = Course::new(&conditions, Pilot::new(navigator, names, None)).unwrap();
        let ending =
            std::iter::from_fn(|| Some(course.step().unwrap())).take(30_000).flatten().next();
        assert_eq!(ending, Some(Ending::Finished));
        let progress = course.pilot().helm().progress();
        assert!(progress.error_rms < 0.025, "seed {seed}: {progress:?}");
    }
}
