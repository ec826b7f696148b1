// SPDX-License-Identifier: MIT

export type GL = WebGL2RenderingContext;
type Uniform = number | readonly number[];

/** Shaders, linked at first use, so that what is not drawn costs nothing; or ahead of it. */
export class Program {
  readonly #gl: GL;
  readonly #sources: readonly [vertex: string, fragment: string];
  readonly #name: string;
  readonly #uniforms = new Map<string, WebGLActiveInfo & { at: WebGLUniformLocation }>();
  #shaders: WebGLShader[] = [];
  #program: WebGLProgram | undefined;
  #isReady = false;
  /** Of a program that is being made: asking more than whether it is done would wait. */
  readonly #parallel: KHR_parallel_shader_compile | null;

  constructor(gl: GL, name: string, vertex: string, fragment: string) {
    this.#gl = gl;
    this.#parallel = gl.getExtension('KHR_parallel_shader_compile');
    this.#name = name;
    this.#sources = [vertex, fragment];
  }
  /** Throws Error with the compiler's words. */
  use(): this {
    this.start();
    if (!this.#isReady) this.#finish(this.#program!);
    this.#gl.useProgram(this.#program!);
    return this;
  }
  /** Using it would not wait. */
  get isMade(): boolean {
    return this.#isReady || !this.#program || !this.#parallel || this.#gl.isContextLost() || (this.#gl.getProgramParameter(this.#program, this.#parallel.COMPLETION_STATUS_KHR) as boolean);
  }
  /** Has it compiled and linked, beside what else goes on: only questions about it would wait. */
  start(): void {
    if (this.#program) return;
    const gl = this.#gl, program = (this.#program = gl.createProgram());
    this.#shaders = [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].map((type, i) => {
      const shader = gl.createShader(type)!;
      gl.shaderSource(shader, this.#sources[i]!);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      return shader;
    });
    gl.linkProgram(program);
  }
  /** After use(). What the program does not have is left out. */
  set(uniforms: Record<string, Uniform>): void {
    const gl = this.#gl;
    for (const [name, value] of Object.entries(uniforms)) {
      const found = this.#uniforms.get(name);
      if (!found) continue;
      const { at, type } = found;
      if (typeof value === 'number') {
        if (type === gl.FLOAT) gl.uniform1f(at, value);
        else gl.uniform1i(at, value);
      } else if (type === gl.FLOAT_VEC2) gl.uniform2fv(at, value);
      else if (type === gl.FLOAT_VEC3) gl.uniform3fv(at, value);
      else if (type === gl.FLOAT_VEC4) gl.uniform4fv(at, value);
      else if (type === gl.FLOAT_MAT3) gl.uniformMatrix3fv(at, false, value);
      else gl.uniformMatrix4fv(at, false, value);
    }
  }

  #finish(program: WebGLProgram): void {
    const gl = this.#gl;
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const said = [gl.getProgramInfoLog(program), ...this.#shaders.map((shader) => gl.getShaderInfoLog(shader))];
      throw new Error(`shader ${this.#name}: ${said.join(' ')}`);
    }
    for (const shader of this.#shaders) gl.deleteShader(shader);
    this.#shaders = [];
    this.#isReady = true;
    const count = (gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) as number | null) ?? 0;
    for (let i = 0; i < count; ++i) {
      const { name, type, size } = gl.getActiveUniform(program, i)!;
      this.#uniforms.set(name, { name, type, size, at: gl.getUniformLocation(program, name)! });
    }
  }
}

export function bindTexture(gl: GL, unit: number, texture: WebGLTexture | null): void {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, texture);
}
/** Of the texture that is bound. */
export function setFilter(gl: GL, filter: number): void {
  for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, filter);
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
}
