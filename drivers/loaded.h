/* drivers/loaded.h
 * A library that is loaded when it is needed, not with the program. Who includes this has defined
 *   LIBRARY                            its file, e.g. "libiio.so.0"
 *   FUNCTIONS(VALUE, VOID, ENTRY)      its functions that are called, with the types that its header declares:
 *     VALUE(name, type, parameters, arguments), VOID(name, parameters, arguments), ENTRY(name, type, parameters)
 * Each VALUE and VOID is defined here under its name and passes the call on: not before load_library() has succeeded.
 * An ENTRY is what is called first; the file defines it, calls load_library() there and passes on to library.name. */
#include <dlfcn.h>
#include <stdbool.h>
#include <stddef.h>

#define MEMBER(name, type, parameters, arguments) type(*name) parameters;
#define VOID_MEMBER(name, parameters, arguments)  void(*name) parameters;
#define ENTRY_MEMBER(name, type, parameters)	  type(*name) parameters;
static struct {
	FUNCTIONS(MEMBER, VOID_MEMBER, ENTRY_MEMBER)
} library;
static void *library_handle;

#define CALL(name, type, parameters, arguments) \
	type name parameters                    \
	{                                       \
		return library.name arguments;  \
	}
#define VOID_CALL(name, parameters, arguments) \
	void name parameters                   \
	{                                      \
		library.name arguments;        \
	}
#define NO_CALL(name, type, parameters)
FUNCTIONS(CALL, VOID_CALL, NO_CALL)

/* A library that was preloaded (LD_PRELOAD) comes first, as for any program that is linked to it. */
static bool find_function(void *handle, const char *name, void **function)
{
	*function = dlsym(RTLD_NEXT, name);
	if (!*function)
		*function = dlsym(handle, name);
	return *function;
}

#define FIND(name, ...) &&find_function(library_handle, #name, (void **)&library.name)
/* False: it is not installed, or has not these functions. It stays loaded, unless unload_library() is called. */
static inline bool load_library(void)
{
	library_handle = dlopen(LIBRARY, RTLD_NOW | RTLD_LOCAL);
	return library_handle FUNCTIONS(FIND, FIND, FIND);
}
static inline void unload_library(void)
{
	dlclose(library_handle);
}
