//! The rule holds and each mutant breaks its invariant, in networks with the fewest datagrams under way that show it.

use flix_orders::{Change, End, Goal, Model, RUNS, Run, World, search, steps};

/// Returns the run in the smallest network in which it ends as expected.
fn in_the_smallest_network(run: &Run) -> Run {
    let needs_two = matches!(run.model.change, Some(Change::NoCounter | Change::OffInAnyOrder));
    let model = Model { up: if needs_two { 2 } else { 1 }, down: 1, ..run.model };
    Run { model: model.renamed(), ..*run }
}

fn check(runs: impl Iterator<Item = &'static Run>) {
    for run in runs.map(in_the_smallest_network) {
        let verdict = search(&run.model);
        assert!(run.is_as_expected(&verdict), "{}: {verdict:?}", run.name);
    }
}

#[test]
fn every_mutant_of_the_robot_and_of_clients_breaks_its_invariant() {
    check(RUNS.iter().filter(|it| it.model.change.is_some() && !it.model.has_programs));
}

#[test]
fn every_mutant_of_programs_breaks_its_invariant() {
    check(RUNS.iter().filter(|it| it.model.change.is_some() && it.model.has_programs));
}

#[test]
fn all_invariants_hold_and_every_goal_of_persons_is_reached() {
    let verdict = search(&Model::new(1, 1).renamed());
    assert!(matches!(verdict.end, End::Holds), "{verdict:?}");
    let unreached = Goal::ALL.into_iter().filter(|it| verdict.goals[*it as usize] == 0);
    assert_eq!(unreached.collect::<Vec<_>>(), [Goal::NextTrial]);
}

#[test]
fn all_invariants_hold_with_programs_and_every_goal_is_reached() {
    let verdict = search(&Model::new(1, 1).with_programs().renamed());
    assert!(matches!(verdict.end, End::Holds), "{verdict:?}");
    assert!(verdict.goals.iter().all(|states| *states > 0), "{:?}", verdict.goals);
}

#[test]
fn a_trace_is_a_history_of_the_model() {
    let model = Model::new(1, 1).with(Change::NoPermit);
    let End::Breaks(invariant, trace) = search(&model).end else { panic!("no invariant breaks") };
    let mut world = World::default();
    for (step, after) in &trace {
        let mut is_possible = false;
        steps(&model, &world, &mut |it, next| is_possible |= it == *step && next == *after);
        assert!(is_possible, "{step} does not follow {world}");
        world = *after;
    }
    assert_eq!(world.broken, Some(invariant));
}
