// What all panels share: what is open, the selected point, requests, changes, and the line that says what happened.
// Events: "opened" (the scene is there), "selected" (a point), "placed" (a place in an image), "changed" (a change was
// stored; event.detail says what), "renewed" (what the whole block says is to be read anew: at once, or where that takes
// long, when no other change has come for a while), "job" (another browser's), "worked" (a job has begun or ended).

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

export class App extends EventTarget {
  constructor(saying) {
    super();
    Object.assign(this, {saying, scene: null, selection: '', before: '', placed: null, last: null, browser: identity(), busy: 0, reading: 0, waiting: 0});
    const look = () => { if (!document.hidden) this.notice(); };
    setInterval(look, LOOK);
    window.addEventListener('focus', look);
  }

  // Whether a job changes the project
  get running() {
    return this.scene?.job?.state === 'running';
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
    if (!found || this.busy) return;
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
    try {
      this.take(...await Promise.all([this.request('/api/scene'), this.request('/api/state')]));
    } catch (error) {
      this.say(error.message, 'error');
    }
    this.reading = performance.now() - began;
    this.emit('renewed');
  }

  // A change whose refusal is said below
  tryTo(body) {
    return this.change(body).catch(error => this.say(error.message, 'error'));
  }

  select(name) {
    if (name !== this.selection) [this.before, this.selection] = [this.selection, name];
    this.say('');
    this.emit('selected', name);
  }

  // A view of an image, a profile or a point: {kind, name; image of a point, point of a profile}
  async look({kind, name, image, point = kind === 'point' ? name : ''}, view) {
    if (kind === 'image') return this.see([{image: name}]);
    if (point) this.select(point);
    if (view === 'images') {
      const {rays} = await this.request(`/api/point?${new URLSearchParams({name: point})}`);
      return rays.length ? this.see([...rays].sort((a, b) => (b.image === image) - (a.image === image)), point) : this.say(`${point} is measured in no image.`, 'error');
    }
    await this.show(view);
    const map = document.getElementById('map').view;
    if (view !== 'map' || !point || !map.view) return undefined;
    const {map_m: place} = await this.request(`/api/point?${new URLSearchParams({name: point})}`);
    if (!place || place.includes(null)) return this.say(`${point} has no place.`, 'error');
    [map.view.x, map.view.y] = place;
    return map.touched();
  }

  // Images side by side, the first one's place in the middle: [{image, line, sample}]
  async see(places, point = '', most = 2) {
    await this.show('images');
    const {view} = document.getElementById('images');
    const ready = () => view.fitted() && view.panes.length >= Math.min(2, this.scene.images.length) && view.panes.every(one => one.image);
    for (let k = 0; k < 100 && !ready(); k += 1) await new Promise(done => { setTimeout(done, 50); });
    for (const [k, {image}] of places.slice(0, most).entries()) {
      const pane = view.panes[k];
      if (!pane) await view.addPane(image);
      else if (pane.name !== image) await pane.choose(pane.chooser.value = image);
    }
    const [{line, sample}] = places;
    if (line !== undefined) {
      view.zoomTo(1);
      view.centreOn(view.frame, [line, sample]);
    }
    if (point) this.emit('selected', point);
    return view;
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
