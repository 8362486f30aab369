/* The WebSocket to imu9-web: requests with their answers, and events. It opens again by itself. */

/** The answer was a refusal. `locked`: the token is needed; `abort`: of the SDO transfer, for example "06090031h". */
export class Refused extends Error {
  constructor(answer) {
    super(answer.error ?? "refused");
    this.locked = answer.locked === true;
    this.abort = answer.abort;
  }
}

const AGAIN_MS = 1000;

export class Connection {
  constructor(url) {
    this.url = url;
    this.next = 1;
    this.waiting = new Map(); /* id -> {done, fail} */
    this.listeners = new Map(); /* event -> set of functions */
    this.open = false;
  }

  connect() {
    const socket = new WebSocket(this.url, "imu9.v1");
    this.socket = socket;
    socket.onopen = () => {
      this.open = true;
      this.tell("open", {});
    };
    socket.onmessage = (message) => this.receive(JSON.parse(message.data));
    socket.onclose = () => {
      this.open = false;
      for (const {fail} of this.waiting.values()) fail(new Refused({error: "no connection to imu9-web"}));
      this.waiting.clear();
      this.tell("close", {});
      setTimeout(() => this.connect(), AGAIN_MS);
    };
  }

  receive(message) {
    if (message.event) {
      this.tell(message.event, message);
      return;
    }
    /* without an id: one that was refused unread; it was the last */
    const id = message.id || [...this.waiting.keys()].pop();
    const waiting = this.waiting.get(id);
    this.waiting.delete(id);
    if (message.ok) waiting?.done(message.result);
    else waiting?.fail(new Refused(message));
  }

  /** Promises the result; fails with Refused. */
  request(op, fields = {}) {
    if (!this.open) return Promise.reject(new Refused({error: "no connection to imu9-web"}));
    const id = this.next++;
    return new Promise((done, fail) => {
      this.waiting.set(id, {done, fail});
      this.socket.send(JSON.stringify({id, op, ...fields}));
    });
  }

  /** Calls f for each such event; returns what ends that. */
  on(event, f) {
    if (!this.listeners.has(event)) this.listeners.set(event, new Set());
    this.listeners.get(event).add(f);
    return () => this.listeners.get(event).delete(f);
  }

  tell(event, message) {
    for (const f of [...(this.listeners.get(event) ?? [])]) f(message);
  }
}
