"""The command line: one function per command, which calls the public interface and prints."""
