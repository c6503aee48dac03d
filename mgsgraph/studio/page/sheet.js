// The sheet of the selected point: its position and sigmas, each measurement with chip, residual and tests; what a user may
// change of it. Each change is stored at once, and the map and this sheet say what it did.

import {Chips} from './chips.js';
import {button, caption, form, make, options, short, table} from './plot.js';
import {worst} from './start.js';

class Sheet {
  constructor(app, element) {
    Object.assign(this, {app, element});
    this.known = make('datalist', {id: 'names-of-points'});
    this.name = make('input', {type: 'text', size: 28, placeholder: 'name of a point, or a part of it'});
    this.name.setAttribute('list', this.known.id);
    this.name.oninput = () => this.propose();
    const show = () => this.name.value.trim() && app.select(this.name.value.trim());
    const asking = form('tools', 'Show a point', show, () => {}, make('label', {}, 'Point ', this.name), this.known,
      make('button', {type: 'submit', textContent: 'Show'}));
    this.body = make('div');
    element.replaceChildren(asking, this.body);
    app.hear(element, ['selected', 'changed'], () => this.show());
    app.hear(element, ['renewed', 'worked'], () => this.drawn !== this.state && !this.body.querySelector('form') && this.show());
    this.show();
  }

  // What a sheet is drawn by, besides its point
  get state() {
    return `${this.app.scene.revision} ${this.app.refusal}`;
  }

  get path() {
    return `/api/point?${new URLSearchParams({name: this.app.selection})}`;
  }

  // Names that contain what is typed
  async propose() {
    const part = this.name.value.trim();
    const names = part ? (await this.app.request(`/api/list?${new URLSearchParams({id: part, count: 20})}`).catch(() => ({rows: []}))).rows : [];
    if (part === this.name.value.trim()) this.known.replaceChildren(...options(names));
  }

  // Without a selected point: the points to look at first
  async offer() {
    const words = make('p', {textContent: 'Select a point on the map, in an image or a list, or name it here. The worst:'});
    this.body.replaceChildren(words);
    const found = await this.app.request('/api/worst').catch(error => { words.textContent = error.message; });
    if (found && !this.app.selection) this.body.append(worst(this.app, found));
  }

  async show() {
    const name = this.app.selection, turn = this.turn = {};
    this.drawn = this.state;
    if (!name) return this.offer();
    this.name.value = name;
    const sheet = await this.app.request(this.path).catch(error => ({error: error.message}));
    if (turn !== this.turn) return undefined;
    if (sheet.error) return this.body.replaceChildren(caption(sheet.error));
    this.sheet = sheet;
    this.draw();
    return this.readMore();
  }

  // Tests and correlations take longer: they come when they are there
  readMore() {
    const {sheet} = this, more = {
      answer: [found => { this.answer.textContent = found.answer.split('\n').slice(1).join('\n'); }, this.answer],
      tests: [found => this.showTests(found), this.testWords],
      correlations: [found => this.showCorrelations(found), this.along.firstElementChild],
    };
    for (const [key, [put, words]] of sheet.adjusted ? Object.entries(more) : [])
      this.app.request(this.path.replace('?', `/${key}?`))
        .then(found => sheet === this.sheet && put(found), error => { words.textContent = error.message; });
  }

  draw() {
    const {sheet} = this, wait = sheet.adjusted ? 'computing …' : '';
    this.body.replaceChildren(
      make('h2', {textContent: `${sheet.name}: ${sheet.class} point, ${sheet.kind}${sheet.edited ? ', changed by hand' : ''}`}),
      make('p', {textContent: this.position(sheet)}), this.answer = make('pre', {textContent: wait}),
      this.rays(), this.testWords = caption(wait && `tests: ${wait}`), this.setAside(), this.actions(), this.forms = make('div'), this.lastChange(),
      make('h3', {textContent: 'Points most correlated with it'}), this.along = make('div', {}, caption(wait || 'known after an adjustment')));
  }

  position({place, sigmas_m: sigmas, rays}) {
    if (!place) return rays.length ? 'Its position is not determined: it needs measurements in two images.' : 'No measurement of it is used.';
    const {longitude_deg: east, latitude_deg: north, geodetic_latitude_deg: graphic, height_m: height} = place;
    const known = sigmas ? `; sigma east ${short(sigmas[0])}, north ${short(sigmas[1])}, up ${short(sigmas[2])} m` : '';
    return `Longitude ${east.toFixed(6)}° E, latitude ${north.toFixed(6)}° (planetocentric; ${graphic.toFixed(6)}° planetographic), `
      + `${height.toFixed(2)} m above the ellipsoid${known}.`;
  }

  rays() {
    this.cells = new Map();
    this.chips = new Chips(this.app);
    const columns = ['chip', 'image', 'line (px)', 'sample (px)', 'σ (px)', 'residual line (px)', 'residual sample (px)', 'redundancy (line, sample)',
      'w-test (line, sample)', 'minimal detectable error (px)', ''];
    const found = table('', columns, this.sheet.rays.map(ray => this.ray(ray)));
    found.querySelector('table')?.classList.add('rays');
    return found;
  }

  // Cells of a measurement; those of its tests are filled later
  ray(ray) {
    const tests = ['redundancy', 'w', 'detectable_px'].map(() => make('td', {className: 'number', textContent: '…'})), place = make('span');
    this.cells.set(ray.image, tests);
    place.append(this.button('Move', `Move the measurement in ${ray.image}`, () => this.moving(ray, place)), ' ',
      this.button('Reject', `Reject the measurement in ${ray.image}`, () => this.change({kind: 'reject', image: ray.image})));
    const [line, sample] = ray.residual_px || [null, null];
    return [ray.picture ? this.chips.of(ray) : '', `${ray.image}${ray.used ? '' : ' (not used)'}`, ray.line.toFixed(2), ray.sample.toFixed(2),
      ray.sigma_px.map(one => short(one)).join(', '), short(line), short(sample), ...tests, place];
  }

  // A button of a change, disabled with its reason
  button(words, title, act) {
    const {refusal} = this.app;
    return button(words, act, {title: refusal || title, disabled: Boolean(refusal)});
  }

  moving(ray, where) {
    const buttons = [...where.childNodes];
    this.open(where, this.placing(ray, ({line, sample}) => this.change({kind: 'move', image: ray.image, line, sample}), () => where.replaceChildren(...buttons)));
  }

  // A form in its place, its first field in focus
  open(where, ...parts) {
    where.replaceChildren(...parts);
    where.querySelector('input').focus();
  }

  // Line and sample in an image, refined against any other measure where both have pixels; Escape gives it up
  placing(ray, store, cancel) {
    const field = (key, value) => make('input', {type: 'number', step: 'any', required: true, value: value === undefined ? '' : Number(value.toFixed(3)), name: key});
    const line = field('line', ray.line), sample = field('sample', ray.sample);
    let sigma = null;
    const refine = async other => {
      const reference = {image: other.image, line: other.line, sample: other.sample};
      const found = await this.app.orSay(this.app.request('/api/refine', {reference, image: ray.image, line: Number(line.value), sample: Number(sample.value)}));
      if (!found) return;
      [line.value, sample.value, sigma] = [found.line.toFixed(3), found.sample.toFixed(3), found.sigma_px];
      this.app.say(found.sentence);
    };
    const others = this.sheet.rays.filter(one => ray.picture && one.image !== ray.image && one.picture);
    for (const one of [line, sample]) one.oninput = () => { sigma = null; };
    return form('placing', `Position in ${ray.image}`, () => store({line: Number(line.value), sample: Number(sample.value), ...(sigma ? {sigma_px: sigma} : {})}), cancel,
      make('label', {}, 'line ', line), ' ', make('label', {}, 'sample ', sample), ' ', make('button', {type: 'submit', textContent: 'Store'}),
      ...others.flatMap(other => [' ', button(`Refine against ${other.image}`, () => refine(other))]), ' ', button('Cancel', cancel));
  }

  // One measurement more: in an image without one, at first where the geometry predicts the point
  adding() {
    const taken = new Set([...this.sheet.rays, ...this.sheet.set_aside].map(one => one.image));
    const left = this.app.scene.images.filter(one => !taken.has(one.name));
    if (!left.length) return this.app.say('It is measured, or rejected, in every image.', 'error');
    const choice = make('select', {}, ...options(left.map(one => [one.name]))), place = make('span');
    const show = async () => {
      const {name: image, picture} = left.find(one => one.name === choice.value), ray = {image, picture: Boolean(picture)};
      const found = await this.app.orSay(this.app.request('/api/questions', {projections: [[this.sheet.name, image]]}));
      if (choice.value !== image) return;
      if (found) {
        [ray.line, ray.sample] = found[0].record.line_sample_px.map(one => Number(one.toFixed(2)));
        this.app.say(`Predicted position of ${this.sheet.name}: line ${ray.line}, sample ${ray.sample} of ${image}.`);
      }
      this.open(place, this.placing(ray, measure => this.change({kind: 'measure', measures: [{image, ...measure}]}), () => this.forms.replaceChildren()));
    };
    choice.onchange = show;
    this.forms.replaceChildren(make('div', {className: 'tools'}, make('label', {}, 'Measure in ', choice), place));
    return show();
  }

  // What the last change of this session moved, the most moved points first
  lastChange() {
    const found = this.app.last;
    if (!found?.moved?.length) return '';
    const more = found.moved.length > 5 ? ` ${found.moved.length - 5} more moved less.` : '';
    const rows = found.moved.slice(0, 5).map(({name, vector_m: vector, sigmas}) => [
      button(name, () => this.app.select(name)), ...(vector ? [...vector, sigmas].map(one => short(one)) : ['new', '', '', ''])]);
    return make('div', {className: 'last-change'}, table('What the last change moved', ['point', 'east (m)', 'north (m)', 'up (m)', 'of its sigmas'], rows),
      caption(found.sentences.join(' ') + more));
  }

  setAside() {
    const aside = this.sheet.set_aside;
    if (!aside.length) return '';
    const items = aside.map(({image, line, sample}) => make('li', {}, `${image}: line ${line.toFixed(2)}, sample ${sample.toFixed(2)} `,
      this.button('Accept', `Accept the measurement in ${image} again`, () => this.change({kind: 'accept', image}))));
    return make('div', {}, make('h3', {textContent: 'Measurements rejected by hand'}), make('ul', {}, ...items));
  }

  actions() {
    const {sheet, app} = this, surveyed = sheet.class === 'laser' || sheet.class === 'post';
    const hold = sheet.kind === 'free' ? this.button('Hold …', 'Hold it at a known position, as ground control', () => this.holding())
      : this.button('Release', 'Hold it no longer', () => this.change({kind: 'release'}));
    return make('div', {className: 'tools'}, this.button('Measure in …', 'Measure it in one more image', () => this.adding()),
      ...(surveyed ? [] : [hold, this.button('Remove', 'Remove the point with all of its measurements', () => this.change({kind: 'remove'}))]),
      button('Show in the images', () => app.look({kind: 'point', name: sheet.name}, 'images')), caption(app.refusal));
  }

  holding() {
    const known = this.sheet.place, place = key => (known ? Number(known[key].toFixed(key === 'height_m' ? 3 : 8)) : '');
    const field = (name, words, value) => make('label', {}, `${words} `, make('input', {type: 'number', step: 'any', value, required: true, name}));
    const fields = [
      field('longitude_deg', 'longitude (deg E)', place('longitude_deg')),
      field('geodetic_latitude_deg', 'latitude (deg, planetographic)', place('geodetic_latitude_deg')),
      field('height_m', 'height above the ellipsoid (m)', place('height_m')),
      ...['east', 'north', 'up'].map(key => field(`sigma_${key}_m`, `σ ${key} (m)`, 10))];
    const hold = () => this.change({kind: 'hold', ...Object.fromEntries(fields.map(({control}) => [control.name, Number(control.value)]))});
    this.open(this.forms, form('tools holding', `Hold ${this.sheet.name}`, hold, () => this.forms.replaceChildren(), ...fields,
      make('button', {type: 'submit', textContent: 'Hold it there'}), button('Cancel', () => this.forms.replaceChildren())));
  }

  change(body) {
    return this.app.tryTo({point: this.sheet.name, ...body});
  }

  showTests({critical, alpha, rays}) {
    for (const [image, cells] of this.cells)
      ['redundancy', 'w', 'detectable_px'].forEach((key, k) => {
        const values = rays[image]?.[key] || [];
        cells[k].replaceChildren(...values.flatMap((one, n) => {
          const alarm = key === 'w' && one !== null && Math.abs(one) > critical;
          return [...(n ? [', '] : []), make('span', {className: alarm ? 'alarm' : '', textContent: short(one)})];
        }), ...(values.length ? [] : ['–']));
      });
    this.testWords.textContent = `A measurement is suspected where |w| exceeds ${short(critical)} (one false alarm in ${short(1 / alpha, 4)} tests). `
      + 'The minimal detectable error is the smallest error that is found with a probability of 80 %.';
  }

  showCorrelations({axes, rows, distance_m: away, looked_at: count}) {
    if (!rows.length) return this.along.replaceChildren(caption('No other point has a position.'));
    const of = ({name, correlation}) => [button(name, () => this.app.select(name)), short(away[name]), ...correlation.map(one => one.toFixed(3).replace('-', '−'))];
    return this.along.replaceChildren(table('', ['point', 'distance (m)', ...axes], rows.map(of)),
      caption(`Of ${count} points that its images show, those whose coordinates are most correlated with its own: 1 = fully correlated errors.`));
  }
}

export {Sheet as Panel};
