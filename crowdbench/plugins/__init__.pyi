from .code import code_digest as code_digest
