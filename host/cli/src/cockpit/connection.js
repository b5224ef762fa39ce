const openConnection = () => new WebSocket(`ws://${location.host}${location.pathname}socket`);
const NO_CONNECTION = "No connection to `flix cockpit`. If it was started again, open the address that it has printed last.";
const drawWorld = () => false;
