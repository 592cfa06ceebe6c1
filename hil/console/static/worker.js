// Holds the line to the server. A worker, because a browser slows down the timers of hidden pages but not its workers; the lock keeps the
// page from being frozen. Every message is a ping, and every ping is answered.
"use strict";
let client = "";
let address = "";
let line = null;

function open() {
  const socket = line = new WebSocket(`${address}?client=${encodeURIComponent(client)}`);
  socket.onmessage = (event) => {
    socket.send("here");
    const told = JSON.parse(event.data);
    if (told.type === "welcome") client = told.client;
    postMessage(told);
  };
  socket.onclose = () => {
    postMessage({ type: "lost" });
    setTimeout(open, 300);
  };
}

onmessage = (event) => {
  if (event.data === "stop") {
    if (line && line.readyState === WebSocket.OPEN) line.send("stop");
    else postMessage({ type: "stop unheard" });
    return;
  }
  if (event.data.move) {
    if (line && line.readyState === WebSocket.OPEN) line.send(`move ${event.data.move}`);
    return;
  }
  ({ client, address } = event.data);
  if (self.navigator.locks) self.navigator.locks.request(`isocenter-bench-${Math.random()}`, () => new Promise(() => {}));
  open();
};
