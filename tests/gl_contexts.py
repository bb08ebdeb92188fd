"""Headless GL 4.5 contexts for moderngl: through EGL, and through OSMesa, for which moderngl has no backend of its own."""
import ctypes

import moderngl

BACKENDS = ("egl", "osmesa")

GL_TEXTURE0 = 0x84C0
GL_TEXTURE_BUFFER = 0x8C2A
GL_RG32UI = 0x823C
GL_R16UI = 0x8234
GL_R32UI = 0x8236
GL_RGBA32F = 0x8814
GL_RGBA32UI = 0x8D70


class OsMesaContext:
    """What moderngl asks of a context: load, __enter__, __exit__, release."""
    RGBA, GL_UNSIGNED_BYTE = 0x1908, 0x1401
    FORMAT, DEPTH_BITS, PROFILE, CORE_PROFILE, MAJOR, MINOR = 0x22, 0x30, 0x33, 0x34, 0x36, 0x37

    def __init__(self):
        self.library = ctypes.CDLL("libOSMesa.so.8")
        self.library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        self.library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        self.library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p] + [ctypes.c_int] * 3
        self.library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        wanted = [self.FORMAT, self.RGBA, self.DEPTH_BITS, 24, self.PROFILE, self.CORE_PROFILE, self.MAJOR, 4, self.MINOR, 5, 0]
        self.handle = self.library.OSMesaCreateContextAttribs((ctypes.c_int * len(wanted))(*wanted), None)
        if not self.handle:
            raise RuntimeError("OSMesa gave no GL 4.5 core context")
        self.pixels = ctypes.create_string_buffer(4 * 16 * 16)
        self.make_current()

    def make_current(self):
        if not self.library.OSMesaMakeCurrent(self.handle, self.pixels, self.GL_UNSIGNED_BYTE, 16, 16):
            raise RuntimeError("OSMesaMakeCurrent failed")

    def load(self, name):
        return self.library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self):
        self.make_current()

    def __exit__(self, *_):
        pass

    def release(self):
        if self.handle:
            self.library.OSMesaDestroyContext(self.handle)
            self.handle = None


class Context:
    """A moderngl context, and the one thing that moderngl lacks: buffer textures."""

    def __init__(self, backend):
        self.backend = backend
        if backend == "osmesa":
            self.adapter = OsMesaContext()
            self.gl = moderngl.create_context(require=450, standalone=True, context=self.adapter)
            self.load = self.adapter.load
        else:
            self.gl = moderngl.create_context(require=450, standalone=True, backend="egl")
            egl = ctypes.CDLL("libEGL.so.1")
            egl.eglGetProcAddress.restype = ctypes.c_void_p
            self.load = lambda name: egl.eglGetProcAddress(name.encode())

    def __enter__(self):
        self.gl.__enter__()
        return self.gl

    def __exit__(self, *what):
        return self.gl.__exit__(*what)

    def call(self, name, *arguments):
        return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p if isinstance(a, ctypes.Array) else ctypes.c_uint for a in arguments])(
            self.load(name))(*arguments)

    def bind_buffer_texture(self, unit, internal_format, buffer):
        """Makes `buffer` readable as a samplerBuffer or usamplerBuffer at texture unit `unit`. Returns the texture's name."""
        name = (ctypes.c_uint * 1)()
        self.call("glGenTextures", 1, name)
        self.call("glActiveTexture", GL_TEXTURE0 + unit)
        self.call("glBindTexture", GL_TEXTURE_BUFFER, name[0])
        self.call("glTexBuffer", GL_TEXTURE_BUFFER, internal_format, buffer.glo)
        return name[0]

    def set_sampler(self, program, name, unit):
        """Texture unit of a sampler, where the program uses it; moderngl's own way passes over buffer samplers."""
        if name in program:
            self.call("glProgramUniform1i", program.glo, program[name].location, unit)
