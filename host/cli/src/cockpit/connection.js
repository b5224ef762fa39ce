const openConnection = () => new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}${location.pathname}socket`);
// `flix cockpit` sends a picture 20 times a second; how long it may stay away.
const SILENT_MS = 1000, GIVE_UP_MS = 5000;
// How long it may leave a STOP unanswered until another one is opened, which may take twice as long.
const DEAF_MS = 1500;
const STOP_UNHEARD = "STOP may not have arrived. Stop the robot with `flix stop`, or at its switch.";
const NO_CONNECTION = "No connection to `flix cockpit`. If it was started again, open the address that it has printed last.";
const drawWorld = () => false, ownPicture = () => undefined;
