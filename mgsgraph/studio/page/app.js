// What all panels share: what is open, the selected point, requests, changes, and the line that says what happened.
// Events: "opened" (the scene is there), "selected" (a point), "placed" (a place in an image), "changed" (a change was
// stored; event.detail says what), "renewed" (what the whole block says is to be read anew: at once, or where that takes
// long, when no other change has come for a while).

const SOON = 700, CALM = 2500, LOOK = 5000; // ms

// The same for all tabs and visits of a browser
function identity() {
  try {
    if (!localStorage.browser) localStorage.browser = crypto.randomUUID();
    return localStorage.browser;
  } catch {
    return crypto.randomUUID(); // a browser that keeps nothing
  }
}

// An answer of the server, which wants the secret of this session; an Error with its sentence where it refuses
export async function ask(path, {headers, ...options} = {}) {
  const answer = await fetch(path, {...options, headers: {...headers, 'X-Secret': localStorage.secret || ''}});
  if (answer.ok) return answer;
  const text = await answer.text(), found = text.startsWith('{') ? JSON.parse(text).error : text.slice(0, 500);
  throw Object.assign(new Error(found || `The studio answered with ${answer.status}.`), {status: answer.status});
}

export class App extends EventTarget {
  constructor(saying) {
    super();
    Object.assign(this, {saying, scene: null, selection: '', placed: null, last: null, browser: identity(), busy: 0, reading: 0});
    const look = () => { if (!document.hidden) this.notice(); };
    setInterval(look, LOOK);
    window.addEventListener('focus', look);
  }

  async open() {
    const [scene, state] = await Promise.all([this.request('/api/scene'), this.request('/api/state')]);
    this.scene = Object.assign(scene, state);
    this.emit('opened');
  }

  emit(name, detail) {
    this.dispatchEvent(new CustomEvent(name, {detail}));
  }

  // The answer of the server as an object; an Error with its sentence where it refuses
  async request(path, body) {
    const options = {headers: {'X-Browser': this.browser}, cache: 'no-store'};
    if (body !== undefined) {
      Object.assign(options, {method: 'POST', body: JSON.stringify(body)});
      options.headers['Content-Type'] = 'application/json';
    }
    let answer;
    try {
      answer = await ask(path, options);
    } catch (error) {
      throw error.status ? error : new Error('The studio does not answer: has its command been ended? What was stored is in the project.');
    }
    const found = await answer.json();
    if (found.error) throw new Error(found.error);
    return found;
  }

  // Store a change; resolves with what it did
  async change(body) {
    this.busy += 1;
    const found = await this.request('/api/changes', body).finally(() => { this.busy -= 1; });
    this.last = found;
    const open = this.scene;
    for (const key of ['revision', 'writable', 'lock', 'warning']) open[key] = found[key] ?? open[key];
    this.say(found.sentences.join(' '));
    this.emit('changed', found);
    clearTimeout(this.calm);
    if (this.reading > SOON) this.calm = setTimeout(() => this.renew(), CALM);
    else this.renew();
    return found;
  }

  // Whether another process, or another browser, has changed the project
  async notice() {
    if (!this.scene || this.scene.kind !== 'project' || this.busy) return;
    const {revision, lock} = this.scene, found = await this.request('/api/state').catch(() => null);
    if (!found || this.busy || (found.revision === revision && found.lock === lock)) return;
    Object.assign(this.scene, found);
    if (found.revision === revision) this.emit('renewed');
    else await this.renew();
  }

  async renew() {
    const began = performance.now();
    try {
      Object.assign(this.scene, await this.request('/api/scene'));
    } catch (error) {
      this.say(error.message, 'error');
    }
    this.reading = performance.now() - began;
    this.emit('renewed');
  }

  async undo() {
    try {
      return await this.change({kind: 'undo'});
    } catch (error) {
      this.say(error.message, 'error');
      return null;
    }
  }

  select(name) {
    this.selection = name;
    this.emit('selected', name);
  }

  // A place of an image that was clicked: {image, line, sample}
  place(found) {
    this.placed = found;
    this.emit('placed', found);
  }

  say(sentence, kind = '') {
    this.saying.textContent = sentence;
    this.saying.className = kind;
  }
}
