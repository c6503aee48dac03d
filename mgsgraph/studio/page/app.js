// What all panels share: what is open, the selected point, requests, changes, and the line that says what happened.
// Events: "opened" (the scene is there; panels are made after it), "shown" (a panel), "selected" (a point), "placed" (a
// position in an image), "changed" (a change was stored; event.detail says what), "renewed" (all that depends on the block
// is to be read again: at once, or where that takes long, when no other change has come for a while), "job" (another
// browser's), "worked" (a job has begun or ended), "judged" (the verdict is there), "candidates" (of the next measurement).

const SOON = 700, CALM = 2500, LOOK = 5000, PATIENCE = 200; // ms
const QUIET = ['/api/state', '/api/work', '/api/verdict']; // asked in the background

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

// Whether a key is pressed with another one, which makes it one of the browser's
export const withModifier = event => event.ctrlKey || event.metaKey || event.altKey;

export class App extends EventTarget {
  constructor(saying) {
    super();
    Object.assign(this, {saying, views: {}, scene: null, selection: '', before: '', placed: null, last: null, candidates: []});
    Object.assign(this, {browser: identity(), busy: 0, reading: 0, waiting: 0});
    const look = () => { if (!document.hidden) this.notice(); };
    setInterval(look, LOOK);
    window.addEventListener('focus', look);
  }

  // Whether a job changes the project
  get running() {
    return this.scene?.job?.state === 'running';
  }

  // Why nothing can be changed now; empty where it can
  get refusal() {
    const {kind, lock, job} = this.scene;
    if (kind !== 'project') return 'Only a project can be changed: make one with mgsgraph project init.';
    return this.running ? `${job.title} is running.` : lock || '';
  }

  async open() {
    const [scene, state] = await Promise.all([this.request('/api/scene'), this.request('/api/state')]);
    this.scene = Object.assign(scene, state);
    this.emit('opened');
  }

  emit(name, detail) {
    this.dispatchEvent(new CustomEvent(name, {detail}));
  }

  // What a panel does at events; while it is hidden not at once, but when it is shown again
  hear(element, names, act) {
    let missed = false;
    const heard = () => {
      missed = element.hidden;
      if (!missed) act();
    };
    for (const name of names) this.addEventListener(name, heard);
    this.addEventListener('shown', () => missed && heard());
  }

  // The answer of the server as an object; an Error with its sentence where it refuses
  async request(path, body) {
    const options = {headers: {'X-Browser': this.browser}, cache: 'no-store'};
    if (body !== undefined) {
      Object.assign(options, {method: 'POST', body: JSON.stringify(body)});
      options.headers['Content-Type'] = 'application/json';
    }
    let answer, late = 0;
    const timer = setTimeout(() => { late = 1; this.wait(1); }, QUIET.includes(path) ? 1e9 : PATIENCE);
    try {
      answer = await ask(path, options);
    } catch (error) {
      throw error.status ? error : new Error('The studio does not answer: has its command been ended? What was stored is in the project.');
    } finally {
      clearTimeout(timer);
      this.wait(-late);
    }
    const found = await answer.json();
    if (found.error) throw new Error(found.error);
    return found;
  }

  // The page says that it waits for an answer
  wait(step) {
    this.waiting += step;
    document.getElementById('waiting').hidden = !this.waiting;
  }

  // Store a change; resolves with what it did
  async change(body) {
    this.busy += 1;
    const found = await this.request('/api/changes', body).finally(() => { this.busy -= 1; });
    this.last = found;
    const open = this.scene;
    for (const key of ['revision', 'writable', 'lock', 'warning']) open[key] = found[key] ?? open[key];
    Object.assign(open, {undo: true, redo: found.kind === 'undo'}); // what is right in most cases, until all is read anew
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
    if (!found || this.busy || this.scene.revision !== revision) return; // older than a change
    this.take(found);
    if (found.job?.state === 'running') this.emit('job');
    if (found.revision === revision && found.lock === lock) return;
    if (found.revision === revision) this.emit('renewed');
    else await this.renew();
  }

  // What the server says; of a job that runs its own watch knows more than answers that were under way
  take(...found) {
    const {running, scene: {job}} = this;
    Object.assign(this.scene, ...found);
    if (running) this.scene.job = job;
  }

  async renew() {
    const began = performance.now();
    this.take(...await this.orSay(Promise.all([this.request('/api/scene'), this.request('/api/state')])) || []);
    this.reading = performance.now() - began;
    this.emit('renewed');
  }

  // The answer of a request; undefined where it fails, and the line below says why
  orSay(promise) {
    return promise.catch(error => this.say(error.message, 'error'));
  }

  tryTo(body) {
    return this.orSay(this.change(body));
  }

  select(name) {
    if (name !== this.selection) [this.before, this.selection] = [this.selection, name];
    this.say('');
    this.emit('selected', name);
  }

  // A view of an image, a profile or a point: {kind, name; image of a point, point of a profile}
  async look({kind, name, image, point = kind === 'point' ? name : ''}, key) {
    if (point) this.select(point);
    const view = await this.show(key);
    if (kind === 'image') return view.see([{image: name}]);
    return point && this.orSay(Promise.resolve(view.lookAt?.(point, image)));
  }

  // A position in an image that was clicked: {image, line, sample}
  place(found) {
    this.placed = found;
    this.emit('placed', found);
  }

  say(sentence, kind = '') {
    this.saying.textContent = sentence;
    this.saying.className = kind;
  }
}
